// A kernel pack that calls something else a sphere than the built-in ones do.
#include "engine/packs/abi.h"

namespace {

using namespace raynest;

constexpr PackPrimitive sphere{"sphere", 4, 1, nullptr, nullptr};
constexpr Pack pack{pack_abi,
                    {sizeof(SceneView), sizeof(ObjectRecord), sizeof(HitRecord), sizeof(TraceCall)},
                    "v2",
                    0,
                    []() noexcept { return true; },
                    nullptr,
                    0,
                    1,
                    &sphere};

}  // namespace

extern "C" [[gnu::visibility("default")]] const raynest::Pack* raynest_pack() noexcept {
    return &pack;
}
