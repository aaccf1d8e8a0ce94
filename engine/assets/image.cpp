// image.h, implemented by the module, which the first picture loads.
#include "engine/assets/exr_header.h"
#include "engine/assets/image_module.h"
#include "engine/assets/module.h"

#include <algorithm>

namespace raynest {
namespace {

Result<ImageModule> image_module() {
    constexpr std::size_t bytes = 512U << 20;  // about 400 MiB on Debian 12
    const auto symbol = load_module({image_module_file, image_module_symbol, bytes,
                                     "pictures need the image module",
                                     "install OpenImageIO and build with RAYNEST_OIIO=ON"});
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

Result<std::vector<std::vector<std::uint32_t>>> decode_exr(std::span<const std::byte> file,
                                                           std::uint32_t width,
                                                           std::uint32_t height,
                                                           std::span<const ChannelType> channels) {
    const auto header = read_exr_header(file);
    if (!header) return tl::unexpected<Error>(header.error());
    if (header->width != width || header->height != height)
        return fail(ErrorCode::scene_invalid,
                    "the EXR has " + std::to_string(header->width) + "x" +
                        std::to_string(header->height) + " pixels, not " + std::to_string(width) +
                        "x" + std::to_string(height));
    std::vector<ChannelType> wanted(channels.begin(), channels.end());
    std::ranges::sort(wanted, {}, &ChannelType::name);  // as an EXR has them
    if (header->channels != wanted)
        return fail(ErrorCode::scene_invalid, "the EXR has other channels");
    const auto module = image_module();
    if (!module) return tl::unexpected<Error>(module.error());
    return module->decode_channels(file, width, height, channels);
}

Result<LightPicture> decode_environment(std::span<const std::byte> file, std::uint32_t side_max,
                                        std::uint64_t bytes_max) {
    const auto module = image_module();
    if (!module) return tl::unexpected<Error>(module.error());
    return module->decode_light(file, side_max, bytes_max);
}

}  // namespace raynest
