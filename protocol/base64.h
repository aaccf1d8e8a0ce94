// Base64 (RFC 4648, with padding): the bytes of files inside JSON and HTML.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::protocol {

[[nodiscard]] std::string to_base64(std::span<const std::byte> bytes);
/// Returns nothing if the text is not Base64.
[[nodiscard]] std::optional<std::vector<std::byte>> from_base64(std::string_view text);
/// Returns the length of the text that to_base64() makes of so many bytes.
[[nodiscard]] constexpr std::uint64_t base64_length(std::uint64_t bytes) {
    return (bytes + 2) / 3 * 4;
}

}  // namespace raynest::protocol
