#include "engine/packs/load.h"

#include "engine/packs/layout.h"
#include "engine/system/module_file.h"

#include <dlfcn.h>

#include <algorithm>
#include <string>
#include <system_error>

namespace raynest {
namespace {

tl::unexpected<Error> other_headers(const std::filesystem::path& path, const std::string& what) {
    return fail(
        ErrorCode::pack_invalid,
        path.string() + " was built against other engine headers (" + what + "): rebuild the pack");
}

std::string other_abi(std::uint32_t theirs, std::uint32_t ours) {
    return "ABI " + std::to_string(theirs) + ", this build has " + std::to_string(ours);
}

/// Returns the first type of `some` that `others` lack or lay out differently, or "".
std::string_view first_without_twin(std::span<const TypeLayout> some,
                                    std::span<const TypeLayout> others) {
    for (const TypeLayout& type : some) {
        const auto is_twin = [&](const TypeLayout& other) {
            return std::string_view(other.name) == type.name && other.hash == type.hash;
        };
        if (std::none_of(others.begin(), others.end(), is_twin)) return type.name;
    }
    return {};
}

template <class Entry>
Result<Entry> load_entry_point(const std::filesystem::path& path, const char* symbol) {
    return load_symbol(path, symbol).map([](void* entry) {
        return reinterpret_cast<Entry>(entry);
    });
}

}  // namespace

Result<void*> load_symbol(const std::filesystem::path& path, const char* symbol) {
    if (const auto whole = check_module_file(path); !whole)
        return fail(ErrorCode::pack_invalid,
                    "cannot load the kernel pack " + path.string() + ": " + whole.error().message);
    // RTLD_LOCAL: packs hold templates of the same names compiled for different CPUs.
    void* const module = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (module == nullptr) {
        const char* why = dlerror();
        return fail(ErrorCode::pack_invalid, "cannot load the kernel pack " + path.string() + ": " +
                                                 (why != nullptr ? why : "unknown reason"));
    }
    void* const entry = dlsym(module, symbol);
    if (entry != nullptr) return entry;
    return fail(ErrorCode::pack_invalid, path.string() + " is no kernel pack" +
                                             (symbol == device_symbol ? " for a device" : "") +
                                             ": it does not export " + symbol);
}

std::string_view differing_type(std::span<const TypeLayout> theirs) {
    const auto ours = border_types();
    const std::string_view changed = first_without_twin(ours, theirs);
    return changed.empty() ? first_without_twin(theirs, ours) : changed;
}

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
    const auto entry = load_entry_point<PackEntry>(path, pack_symbol);
    if (!entry) return tl::unexpected(entry.error());
    const Pack* const pack = (*entry)();
    if (pack->abi != pack_abi) return other_headers(path, other_abi(pack->abi, pack_abi));
    const std::string_view type = differing_type({pack->types, pack->type_count});
    if (!type.empty()) return other_headers(path, "type " + std::string(type) + " differs");
    return pack;
}

Result<DevicePack> load_device_pack(const std::filesystem::path& path) {
    const auto pack = load_pack(path);
    if (!pack) return tl::unexpected(pack.error());
    const auto entry = load_entry_point<DeviceEntry>(path, device_symbol);
    if (!entry) return tl::unexpected(entry.error());
    const Device* const device = (*entry)();
    if (device->abi != device_abi) return other_headers(path, other_abi(device->abi, device_abi));
    return DevicePack{*pack, device};
}

}  // namespace raynest
