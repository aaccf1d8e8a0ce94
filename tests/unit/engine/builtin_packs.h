// The kernel packs of the build.
#pragma once

#include "engine/packs/registry.h"

#include <stdexcept>

namespace raynest::test {

/// Throws if they cannot be loaded.
inline const Registry& registry() {
    static const auto loaded = Registry::load({});
    if (!loaded) throw std::runtime_error(loaded.error().message);
    return **loaded;
}

}  // namespace raynest::test
