#include "tests/bench/peer.h"

#include <dlfcn.h>

#include <array>
#include <string_view>

namespace raynest::bench {
namespace {

/// The test of the kernel packs (packs/pack.cmake).
bool runs(std::string_view target) {
    __builtin_cpu_init();
    if (target == "v4") return RAYNEST_CPU_TEST_V4;
    return target == "v3" ? RAYNEST_CPU_TEST_V3 : RAYNEST_CPU_TEST_V2;
}

}  // namespace

std::filesystem::path module_dir() {
    std::error_code error;
    const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
    return self.parent_path().parent_path() / "lib" / "raynest-bench";
}

Result<std::unique_ptr<PeerLibrary>> load_peers(std::string_view target_max) {
    for (const std::string_view target : std::array<std::string_view, 3>{"v4", "v3", "v2"}) {
        const auto module = module_dir() / ("embree-" + std::string(target) + ".so");
        // The names are in the order of what they can do.
        if (target > target_max || !runs(target) || !std::filesystem::exists(module)) continue;
        // RTLD_LOCAL, as for kernel packs: modules hold the same templates for different CPUs.
        void* loaded = dlopen(module.c_str(), RTLD_NOW | RTLD_LOCAL);
        void* entry = loaded != nullptr ? dlsym(loaded, peer_symbol) : nullptr;
        if (entry == nullptr) {
            const char* why = dlerror();
            return fail(ErrorCode::pack_invalid, why != nullptr ? why : module.string());
        }
        return std::unique_ptr<PeerLibrary>(reinterpret_cast<PeerEntry>(entry)());
    }
    return fail(ErrorCode::variant_unknown,
                "this build has no Embree: install libembree-dev and configure again");
}

}  // namespace raynest::bench
