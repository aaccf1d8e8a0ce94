// Decoding and encoding of pictures. OpenImageIO stands behind image_module.h.
#pragma once

#include "engine/result.h"
#include "engine/scene/description.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

namespace raynest {

/// PNG, JPEG or WebP by magic bytes, nothing else; the header's dimensions are checked against the
/// limits before a pixel is decoded. A truncated picture is an error.
Result<ImageDescription> decode_image(std::span<const std::byte> file, std::uint32_t side_max,
                                      std::uint64_t bytes_max);

/// `format` is "png".
Result<std::vector<std::byte>> encode_picture(std::uint32_t width, std::uint32_t height,
                                              std::span<const std::uint8_t> rgba,
                                              std::string_view format);

/// One named channel of 32-bit values for EXR; exactly one of the two spans is set.
struct Channel {
    std::string_view name;
    std::span<const float> f32;
    std::span<const std::uint32_t> u32;
};
Result<std::vector<std::byte>> encode_exr(std::uint32_t width, std::uint32_t height,
                                          std::span<const Channel> channels);

/// scene_unsupported, with what to do, where the build has no OpenImageIO or it does not load: the
/// functions above then fail alike. The first call in a process may take 0.2 s.
Result<void> images_available();

}  // namespace raynest
