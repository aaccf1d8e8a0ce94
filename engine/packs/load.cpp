#include "engine/packs/load.h"

#include <dlfcn.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <string>
#include <system_error>

namespace raynest {
namespace {

template <class Entry>
Result<Entry> find_door(const std::filesystem::path& path, const char* symbol) {
    // A pipe would keep dlopen waiting for ever.
    std::error_code unreadable;
    if (!std::filesystem::is_regular_file(path, unreadable))
        return fail(ErrorCode::pack_invalid,
                    "cannot load the kernel pack " + path.string() + ": it is no regular file");
    // RTLD_LOCAL: packs hold templates of the same names compiled for different CPUs.
    void* const module = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (module == nullptr) {
        const char* why = dlerror();
        return fail(ErrorCode::pack_invalid, "cannot load the kernel pack " + path.string() + ": " +
                                                 (why != nullptr ? why : "unknown reason"));
    }
    const auto entry = reinterpret_cast<Entry>(dlsym(module, symbol));
    if (entry != nullptr) return entry;
    return fail(ErrorCode::pack_invalid, path.string() + " is no kernel pack" +
                                             (symbol == device_symbol ? " for a device" : "") +
                                             ": it does not export " + symbol);
}

tl::unexpected<Error> other_headers(const std::filesystem::path& path, std::uint32_t abi,
                                    std::uint32_t ours) {
    return fail(ErrorCode::pack_invalid, path.string() +
                                             " was built against other engine headers (ABI " +
                                             std::to_string(abi) + ", this build has " +
                                             std::to_string(ours) + "): rebuild the pack");
}

}  // namespace

Result<std::vector<std::filesystem::path>> packs_in(const std::filesystem::path& folder) {
    std::error_code error;
    std::vector<std::filesystem::path> packs;
    for (std::filesystem::directory_iterator it(folder, error), end; !error && it != end;
         it.increment(error)) {
        if (it->path().extension() == ".so") packs.push_back(it->path());
    }
    if (error)
        return fail(ErrorCode::pack_invalid,
                    "cannot read the pack directory " + folder.string() + ": " + error.message());
    std::sort(packs.begin(), packs.end());
    return packs;
}

Result<const Pack*> load_pack(const std::filesystem::path& path) {
    const auto door = find_door<PackEntry>(path, pack_symbol);
    if (!door) return tl::unexpected(door.error());
    const Pack* const pack = (*door)();
    const std::array<std::uint32_t, 4> sizes{sizeof(SceneView), sizeof(ObjectRecord),
                                             sizeof(HitRecord), sizeof(TraceCall)};
    if (pack->abi != pack_abi || !std::equal(sizes.begin(), sizes.end(), pack->sizes))
        return other_headers(path, pack->abi, pack_abi);
    return pack;
}

Result<DevicePack> load_device_pack(const std::filesystem::path& path) {
    const auto pack = load_pack(path);
    if (!pack) return tl::unexpected(pack.error());
    const auto door = find_door<DeviceEntry>(path, device_symbol);
    if (!door) return tl::unexpected(door.error());
    const Device* const device = (*door)();
    if (device->abi != device_abi) return other_headers(path, device->abi, device_abi);
    return DevicePack{*pack, device};
}

}  // namespace raynest
