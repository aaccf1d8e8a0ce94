#include "engine/system/module.h"

#include "engine/system/module_file.h"

#include <dlfcn.h>
#include <fmt/format.h>
#include <sys/mman.h>

#include <filesystem>
#include <string>
#include <system_error>
#include <vector>

namespace raynest {
namespace {

/// Returns the file that dlopen() finds by the run path of this code; empty if there is none.
std::filesystem::path find_module(const char* file) {
    Dl_info here{};
    void* self = nullptr;
    if (dladdr1(reinterpret_cast<void*>(&load_module), &here, &self, RTLD_DL_LINKMAP) == 0)
        return {};
    Dl_serinfo size{};
    if (dlinfo(self, RTLD_DI_SERINFOSIZE, &size) != 0) return {};
    std::vector<std::max_align_t> storage(size.dls_size / sizeof(std::max_align_t) + 1);
    auto* const folders = reinterpret_cast<Dl_serinfo*>(storage.data());
    if (dlinfo(self, RTLD_DI_SERINFOSIZE, folders) != 0 ||
        dlinfo(self, RTLD_DI_SERINFO, folders) != 0)
        return {};
    std::error_code error;
    for (unsigned i = 0; i < folders->dls_cnt; ++i)
        if (auto path = std::filesystem::path(folders->dls_serpath[i].dls_name) / file;
            std::filesystem::exists(path, error))
            return path;
    return {};
}

tl::unexpected<Error> unusable(const Module& module, const std::string& why) {
    return fail(ErrorCode::scene_unsupported,
                fmt::format("{} ({}): {}", module.need, why, module.remedy));
}

bool is_room(std::size_t bytes) {
    void* const at = ::mmap(nullptr, bytes, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (at == MAP_FAILED) return false;
    ::munmap(at, bytes);
    return true;
}

}  // namespace

Result<void*> load_module(const Module& module) {
    // For a loaded module, dlopen only adds a reference.
    void* loaded = dlopen(module.file, RTLD_LAZY | RTLD_LOCAL | RTLD_NOLOAD);
    // Short of memory, dlopen reports a broken file, or a library's constructor aborts.
    if (loaded == nullptr && !is_room(module.bytes)) {
        return fail(ErrorCode::out_of_memory,
                    fmt::format("no memory left to load {}", module.file));
    }
    if (loaded == nullptr)
        if (const auto whole = check_module_file(find_module(module.file)); !whole)
            return unusable(module, whole.error().message);
    // The image module brings some 250 libraries; most of their functions are never called.
    if (loaded == nullptr) loaded = dlopen(module.file, RTLD_LAZY | RTLD_LOCAL);
    void* const symbol = loaded == nullptr ? nullptr : dlsym(loaded, module.symbol);
    if (symbol != nullptr) return symbol;
    const char* why = dlerror();
    return unusable(module, why != nullptr ? why : "unknown reason");
}

}  // namespace raynest
