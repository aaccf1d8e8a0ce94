// Decodes and encodes pictures; OpenImageIO is hidden behind image_module.h.
//
// All functions are thread-safe and block; none reads or writes a file.
#pragma once

#include "engine/assets/images/channels.h"
#include "engine/result.h"
#include "engine/scene/description.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

/// Decodes PNG, JPEG or WebP, recognised by magic bytes. The header's dimensions are checked before
/// a pixel is decoded: at most `side_max` pixels a side, and `bytes_max` bytes of RGBA. Row 0 is
/// the top one; alpha is straight, and 255 if the file has none.
///
/// scene_unsupported: another format, or no image module. limit_exceeded: too large.
/// scene_invalid: damaged or cut short. out_of_memory: the picture may be valid.
Result<ImageDescription> decode_image(std::span<const std::byte> file, std::uint32_t side_max,
                                      std::uint64_t bytes_max);

/// Bound for the header and metadata of an encoded file.
inline constexpr std::uint64_t image_header_bytes_max = 16384;

/// Encodes `rgba`: width * height * 4 bytes of sRGB and straight alpha, row 0 on top. Attributes
/// become text chunks; they take at most image_header_bytes_max / 2 bytes.
///
/// Both encoders fail with scene_unsupported without the image module, with out_of_memory, and with
/// internal if the spans do not fill the picture or the library fails.
Result<std::vector<std::byte>> encode_png(std::uint32_t width, std::uint32_t height,
                                          std::span<const std::uint8_t> rgba,
                                          std::span<const Attribute> attributes = {});
/// Returns the most bytes that encode_png may return. A row has one byte for its filter; deflate
/// stores incompressible data with 5 bytes per 16 KiB and 12 per chunk of 8 KiB (together 1/560);
/// the header is added.
[[nodiscard]] constexpr std::uint64_t png_bytes_max(std::uint32_t width, std::uint32_t height) {
    const std::uint64_t rows = (std::uint64_t{4} * width + 1) * height;
    return rows + rows / 256 + image_header_bytes_max;
}

/// Encodes the channels in the order given; lossless, and equal input gives equal bytes. The
/// attributes take at most image_header_bytes_max / 2 bytes.
Result<std::vector<std::byte>> encode_exr(std::uint32_t width, std::uint32_t height,
                                          std::span<const Channel> channels,
                                          std::span<const Attribute> attributes = {});
/// Returns the most bytes that encode_exr may return: an incompressible block of 16 rows is stored
/// as it is, with an entry of 8 bytes in a table and a header of 8.
[[nodiscard]] constexpr std::uint64_t exr_bytes_max(std::uint32_t width, std::uint32_t height,
                                                    std::uint32_t channels) {
    const std::uint64_t blocks = height / 16 + 1;
    constexpr std::uint64_t description = 64;  // a channel's bytes in the header
    return (std::uint64_t{4} * width * height + description) * channels + 16 * blocks +
           image_header_bytes_max;
}

/// The channels of an EXR: a plane of words for each, row 0 on top; floats as their bits.
struct ExrPlanes {
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::vector<std::vector<std::uint32_t>> planes;  ///< in the order of the file's header
};
/// Decodes an EXR as encode_exr() writes it, with limits as decode_image() has them. The header is
/// checked before a decoder sees the file (exr_header.h).
///
/// scene_unsupported: no EXR, or no image module. limit_exceeded: too large. scene_invalid: another
/// kind of EXR, damaged or cut short. out_of_memory: the file may be valid.
Result<ExrPlanes> decode_exr(std::span<const std::byte> file, std::uint32_t side_max,
                             std::uint64_t bytes_max);

/// Linear colours, row 0 on top.
struct LightPicture {
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::vector<Vec3> rgb;
    std::uint32_t left_out = 0;  ///< number of pixels that no light can have; they are black
};
/// Most radiance of a pixel: sums over a whole picture stay finite. An infinite pixel that was
/// written as HDR, whose numbers end at 1.7e38, has more.
inline constexpr float light_radiance_max = 1e28F;
/// Decodes an EXR or a Radiance HDR, recognised by magic bytes, with limits and errors as
/// decode_image() has them. Of an EXR only one part with channels R, G and B, or Y, is taken.
/// Negative values become 0. A pixel with a value that is not finite, or above light_radiance_max,
/// is left out.
Result<LightPicture> decode_environment(std::span<const std::byte> file, std::uint32_t side_max,
                                        std::uint64_t bytes_max);

/// Loads the image module. scene_unsupported, with the remedy, if the build has no OpenImageIO or
/// it does not load; the functions above then fail alike. out_of_memory if there is no room to load
/// it. The first call in a process may take 0.2 s.
Result<void> images_available();

}  // namespace raynest
