#include "tests/bench/peer.h"

#include <dlfcn.h>

#include <array>
#include <utility>

namespace raynest::bench {
namespace {

/// The test of the kernel packs (packs/pack.cmake).
bool runs(std::string_view target) {
    __builtin_cpu_init();
    if (target == "v4") return RAYNEST_CPU_TEST_V4;
    return target == "v3" ? RAYNEST_CPU_TEST_V3 : RAYNEST_CPU_TEST_V2;
}

/// Null when there is no module of this peer.
Result<std::unique_ptr<PeerLibrary>> load_peer(const std::string& peer,
                                               std::string_view target_max) {
    for (const std::string_view target : std::array<std::string_view, 3>{"v4", "v3", "v2"}) {
        const auto module = module_dir() / (peer + "-" + std::string(target) + ".so");
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
    return std::unique_ptr<PeerLibrary>();
}

}  // namespace

std::filesystem::path module_dir() {
    std::error_code error;
    const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
    return self.parent_path().parent_path() / "lib" / "raynest-bench";
}

Result<std::vector<std::unique_ptr<PeerLibrary>>> load_peers(std::string_view target_max) {
    std::vector<std::unique_ptr<PeerLibrary>> peers;
    for (const char* name : {"embree", "tinybvh"}) {
        auto peer = load_peer(name, target_max);
        if (!peer) return tl::unexpected(peer.error());
        if (*peer != nullptr) peers.push_back(std::move(*peer));
    }
    if (!peers.empty()) return peers;
    return fail(ErrorCode::variant_unknown,
                "this build has no peer: install libembree-dev, or pass -DRAYNEST_TINYBVH=DIR, and "
                "configure again");
}

}  // namespace raynest::bench
