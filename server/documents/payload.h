// The one payload of an answer, complete in memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <vector>

namespace raynest::server {

/// An encoded file, raw rows, or a JSON document about rays.
struct Payload {
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::vector<std::byte> bytes;
    std::uint32_t samples = 0;  ///< per pixel, of a film
    bool last = true;           ///< false: a later payload replaces this one
    float exposure = 0;         ///< a linear film's: auto_exposure()
};

/// Returns the payload of a JSON document about a picture of this size.
[[nodiscard]] Payload json_payload(std::uint32_t width, std::uint32_t height,
                                   std::string_view text);

}  // namespace raynest::server
