// The interface between the engine and the module that uses OpenImageIO (image_module.cpp).
//
// OpenImageIO needs 240 shared libraries. Loading them took 0.2 s of processor time at each start
// of the daemon and of every import child, most of which never read a picture. So image.cpp loads
// the module with the first one. Both sides come from one build.
#pragma once

#include "engine/assets/images/exr_header.h"
#include "engine/assets/images/image.h"

namespace raynest {

/// The functions that image.h declares, or their part that needs the library.
struct ImageModule {
    decltype(&decode_image) decode;
    decltype(&encode_png) encode_rgba;
    decltype(&encode_exr) encode_channels;
    /// Returns a plane for each channel of the header, in its order.
    Result<std::vector<std::vector<std::uint32_t>>> (*decode_channels)(
        std::span<const std::byte> file, const ExrHeader& header);
    decltype(&decode_environment) decode_light;
};

/// Names for load_module().
inline constexpr const char* image_module_file = "raynest-images.so";
inline constexpr const char* image_module_symbol = "raynest_images";
using ImageModuleEntry = ImageModule (*)() noexcept;

}  // namespace raynest
