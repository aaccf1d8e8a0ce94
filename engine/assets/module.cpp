#include "engine/assets/module.h"

#include <dlfcn.h>
#include <fmt/format.h>
#include <sys/mman.h>

namespace raynest {
namespace {

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
    // The image module brings some 250 libraries; most of their functions are never called.
    if (loaded == nullptr) loaded = dlopen(module.file, RTLD_LAZY | RTLD_LOCAL);
    void* const symbol = loaded == nullptr ? nullptr : dlsym(loaded, module.symbol);
    if (symbol != nullptr) return symbol;
    const char* why = dlerror();
    return fail(ErrorCode::scene_unsupported,
                fmt::format("{} ({}): {}", module.need, why != nullptr ? why : "unknown reason",
                            module.remedy));
}

}  // namespace raynest
