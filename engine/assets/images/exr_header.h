// The header of an EXR from outside, checked before a decoder sees the file.
#pragma once

#include "engine/assets/images/channels.h"
#include "engine/result.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

/// The header of a file as encode_exr() writes it: one part, whole scan lines, ZIP.
struct ExrHeader {
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::vector<ChannelType> channels;  ///< in the order of the file
    std::vector<Attribute> attributes;  ///< those of type string
};

/// Bytes of the channels, decoded.
[[nodiscard]] inline std::uint64_t decoded_bytes(const ExrHeader& header) {
    return std::uint64_t{4} * header.width * header.height * header.channels.size();
}

/// Limits on what a header may hold.
inline constexpr std::size_t exr_attributes_max = 128;
inline constexpr std::size_t exr_attribute_bytes_max = 16384;

/// Fails with scene_invalid, saying what is wrong: another kind of EXR, a window that does not
/// begin at 0, lengths beyond the file or the limits above.
Result<ExrHeader> read_exr_header(std::span<const std::byte> file);

/// Returns the place of each of `channels` in the file. Fails with scene_invalid if the file has
/// another size, or not exactly these channels.
Result<std::vector<std::size_t>> find_channels(const ExrHeader& header, std::uint32_t width,
                                               std::uint32_t height,
                                               std::span<const ChannelType> channels);

}  // namespace raynest
