// Numbers in the bytes of a file.
#pragma once

#include <cstddef>
#include <cstring>
#include <span>

namespace raynest {

/// Returns the little-endian number at `at`. The caller has checked that all of its bytes are there.
template <class Number>
[[nodiscard]] Number number_at(std::span<const std::byte> bytes, std::size_t at) {
    Number value{};
    std::memcpy(&value, bytes.data() + at, sizeof value);
    return value;
}

}  // namespace raynest
