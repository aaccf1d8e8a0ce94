// image.h by way of the module, loaded when the first picture comes.
#include "engine/assets/image_module.h"

#include <dlfcn.h>
#include <fmt/format.h>
#include <sys/mman.h>

namespace raynest {
namespace {

/// Address space for the module and its libraries: about 400 MiB on Debian 12.
constexpr std::size_t module_bytes = 512U << 20;

bool is_room(std::size_t bytes) {
    void* const at = ::mmap(nullptr, bytes, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (at == MAP_FAILED) return false;
    ::munmap(at, bytes);
    return true;
}

/// Loads it once: for a module that is there, dlopen only counts. Never closed.
Result<ImageModule> image_module() {
    void* module = dlopen(image_module_file, RTLD_NOW | RTLD_LOCAL | RTLD_NOLOAD);
    // Short of memory, dlopen fails as if a file were broken, or a library's constructor aborts.
    if (module == nullptr && !is_room(module_bytes))
        return fail(ErrorCode::out_of_memory, "no memory left to load the image module");
    if (module == nullptr) module = dlopen(image_module_file, RTLD_NOW | RTLD_LOCAL);
    void* symbol = module == nullptr ? nullptr : dlsym(module, image_module_symbol);
    if (symbol != nullptr) return reinterpret_cast<ImageModuleEntry>(symbol)();
    const char* why = dlerror();
    return fail(ErrorCode::scene_unsupported,
                fmt::format("pictures need the image module ({}): install OpenImageIO and build "
                            "with RAYNEST_OIIO=ON",
                            why != nullptr ? why : "unknown reason"));
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
                                          std::span<const std::uint8_t> rgba) {
    const auto module = image_module();
    if (!module) return tl::unexpected<Error>(module.error());
    return module->encode_rgba(width, height, rgba);
}

Result<std::vector<std::byte>> encode_exr(std::uint32_t width, std::uint32_t height,
                                          std::span<const Channel> channels) {
    const auto module = image_module();
    if (!module) return tl::unexpected<Error>(module.error());
    return module->encode_channels(width, height, channels);
}

}  // namespace raynest
