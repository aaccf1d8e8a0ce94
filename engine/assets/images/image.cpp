// image.h, implemented by the module, which the first picture loads.
#include "engine/assets/images/exr_header.h"
#include "engine/assets/images/image_module.h"
#include "engine/system/module.h"

#include <string>
#include <utility>

namespace raynest {
namespace {

Result<ImageModule> image_module() {
    constexpr std::size_t bytes = 512U << 20;  // about 400 MiB on Debian 12
    const auto symbol = load_module({image_module_file, image_module_symbol, bytes,
                                     "pictures need the image module",
                                     "install " RAYNEST_IMAGE_PACKAGE " where raynestd runs"});
    if (!symbol) return tl::unexpected<Error>(symbol.error());
    return reinterpret_cast<ImageModuleEntry>(*symbol)();
}

}  // namespace

Result<void> images_available() {
    const auto module = image_module();
    if (!module) return tl::unexpected<Error>(module.error());
    return {};
}

Result<ImageDescription> decode_image(std::span<const std::byte> file, std::uint32_t side_max,
                                      std::uint64_t bytes_max) {
    const auto module = image_module();
    if (!module) return tl::unexpected<Error>(module.error());
    return module->decode(file, side_max, bytes_max);
}

Result<std::vector<std::byte>> encode_png(std::uint32_t width, std::uint32_t height,
                                          std::span<const std::uint8_t> rgba,
                                          std::span<const Attribute> attributes) {
    const auto module = image_module();
    if (!module) return tl::unexpected<Error>(module.error());
    return module->encode_rgba(width, height, rgba, attributes);
}

Result<std::vector<std::byte>> encode_exr(std::uint32_t width, std::uint32_t height,
                                          std::span<const Channel> channels,
                                          std::span<const Attribute> attributes) {
    const auto module = image_module();
    if (!module) return tl::unexpected<Error>(module.error());
    return module->encode_channels(width, height, channels, attributes);
}

Result<ExrPlanes> decode_exr(std::span<const std::byte> file, std::uint32_t side_max,
                             std::uint64_t bytes_max) {
    const auto header = read_exr_header(file);
    if (!header) return tl::unexpected<Error>(header.error());
    if (header->width > side_max || header->height > side_max || decoded_bytes(*header) > bytes_max)
        return fail(ErrorCode::limit_exceeded,
                    "the EXR has " + std::to_string(header->width) + " x " +
                        std::to_string(header->height) + " pixels of " +
                        std::to_string(header->channels.size()) + " channels; at most " +
                        std::to_string(side_max) + " a side and " +
                        std::to_string(bytes_max >> 20) + " MiB decoded are allowed");
    const auto module = image_module();
    if (!module) return tl::unexpected<Error>(module.error());
    auto planes = module->decode_channels(file, *header);
    if (!planes) return tl::unexpected<Error>(planes.error());
    return ExrPlanes{header->width, header->height, std::move(*planes)};
}

Result<LightPicture> decode_environment(std::span<const std::byte> file, std::uint32_t side_max,
                                        std::uint64_t bytes_max) {
    const auto module = image_module();
    if (!module) return tl::unexpected<Error>(module.error());
    return module->decode_light(file, side_max, bytes_max);
}

}  // namespace raynest
