// Stands in for image.cpp in a build without OpenImageIO (RAYNEST_OIIO=OFF): textures and encoded
// pictures are refused by name, raw columns still work.
#include "engine/assets/image.h"

namespace raynest {
namespace {

tl::unexpected<Error> absent() {
    return fail(ErrorCode::scene_unsupported,
                "this build has no OpenImageIO: build with RAYNEST_OIIO=ON to decode textures and "
                "encode pictures, or ask for raw columns");
}

}  // namespace

bool images_available() {
    return false;
}

Result<ImageDescription> decode_image(std::span<const std::byte>, std::uint32_t, std::uint64_t) {
    return absent();
}

Result<std::vector<std::byte>> encode_picture(std::uint32_t, std::uint32_t,
                                              std::span<const std::uint8_t>, std::string_view) {
    return absent();
}

Result<std::vector<std::byte>> encode_exr(std::uint32_t, std::uint32_t, std::span<const Channel>) {
    return absent();
}

}  // namespace raynest
