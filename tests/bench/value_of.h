// For programs that go on only where all goes well.
#pragma once

#include "engine/result.h"

#include <stdexcept>
#include <utility>

namespace raynest::bench {

/// Throws std::runtime_error with the error's message.
template <class T>
T value_of(Result<T> result) {
    if (!result) throw std::runtime_error(result.error().message);
    return std::move(*result);
}

}  // namespace raynest::bench
