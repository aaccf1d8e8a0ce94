// Decoding and encoding of pictures. OpenImageIO stands behind image_module.h.
//
// All functions are thread-safe and block; none reads or writes a file.
#pragma once

#include "engine/result.h"
#include "engine/scene/description.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

namespace raynest {

/// PNG, JPEG or WebP by magic bytes, nothing else. The header's dimensions are checked before a
/// pixel is decoded: `side_max` pixels a side, `bytes_max` bytes of RGBA. Row 0 is the top one;
/// alpha is straight, and 255 where the file has none.
///
/// scene_unsupported: another format, or no image module. limit_exceeded: too large.
/// scene_invalid: damaged, a cut file included. out_of_memory: nothing is known of the picture.
Result<ImageDescription> decode_image(std::span<const std::byte> file, std::uint32_t side_max,
                                      std::uint64_t bytes_max);

/// Header and metadata of an encoded file.
inline constexpr std::uint64_t image_header_bytes_max = 4096;

/// `rgba`: width * height * 4 bytes of sRGB and straight alpha, row 0 on top.
///
/// Both encoders: scene_unsupported without the image module, out_of_memory, and internal where
/// the spans do not fill the picture or the library fails.
Result<std::vector<std::byte>> encode_png(std::uint32_t width, std::uint32_t height,
                                          std::span<const std::uint8_t> rgba);
/// Bytes of that file at most. A row has one byte for its filter; what deflate cannot compress it
/// stores, with 5 bytes per 16 KiB and 12 per chunk of 8 KiB (together 1/560); and the header.
[[nodiscard]] constexpr std::uint64_t png_bytes_max(std::uint32_t width, std::uint32_t height) {
    const std::uint64_t rows = (std::uint64_t{4} * width + 1) * height;
    return rows + rows / 256 + image_header_bytes_max;
}

/// One named channel of 32-bit values for EXR; exactly one of the two spans is set, with
/// width * height values, row 0 on top.
struct Channel {
    std::string_view name;
    std::span<const float> f32;
    std::span<const std::uint32_t> u32;
};
/// The channels in the order given; lossless, equal input gives equal bytes.
Result<std::vector<std::byte>> encode_exr(std::uint32_t width, std::uint32_t height,
                                          std::span<const Channel> channels);
/// Bytes of that file at most: a block of 16 rows that does not get smaller is stored as it is,
/// behind its place in a table of 8 bytes and a head of 8.
[[nodiscard]] constexpr std::uint64_t exr_bytes_max(std::uint32_t width, std::uint32_t height,
                                                    std::uint32_t channels) {
    const std::uint64_t blocks = height / 16 + 1;
    return std::uint64_t{4} * width * height * channels + 16 * blocks + image_header_bytes_max;
}

/// scene_unsupported, with what to do, where the build has no OpenImageIO or it does not load: the
/// functions above then fail alike; out_of_memory where there is no room to load it. The first call
/// in a process may take 0.2 s.
Result<void> images_available();

}  // namespace raynest
