// The border between the engine and the module that knows OpenImageIO (image_module.cpp).
//
// OpenImageIO brings 240 shared libraries; loading them took 0.2 s of processor time at each start
// of the daemon and of every import child, and most of them never see a picture. So image.cpp loads
// the module with the first one. Both sides come out of one build.
#pragma once

#include "engine/assets/image.h"

namespace raynest {

/// What image.h promises.
struct ImageModule {
    decltype(&decode_image) decode;
    decltype(&encode_png) encode_rgba;
    decltype(&encode_exr) encode_channels;
};

/// For load_module().
inline constexpr const char* image_module_file = "raynest-images.so";
inline constexpr const char* image_module_symbol = "raynest_images";
using ImageModuleEntry = ImageModule (*)() noexcept;

}  // namespace raynest
