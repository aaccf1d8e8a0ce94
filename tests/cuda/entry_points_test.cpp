// The cuda pack's entry points: it loads on any machine, and reports when there is no GPU.
#include "engine/packs/registry.h"
#include "engine/scene/snapshot.h"
#include "tests/conformance/scenes.h"

#include <dlfcn.h>
#include <doctest/doctest.h>

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

using namespace raynest;

namespace {

const Pack& cuda_pack() {
    void* const module = dlopen(RAYNEST_CUDA_PACK, RTLD_NOW | RTLD_LOCAL);
    REQUIRE_MESSAGE(module != nullptr, dlerror());
    const auto entry = reinterpret_cast<PackEntry>(dlsym(module, pack_symbol));
    REQUIRE((entry != nullptr));
    return *entry();
}

}  // namespace

TEST_CASE("the cuda pack has a kernel for every intersector of the CPU's packs") {
    const auto registry = Registry::load({});
    REQUIRE(registry.has_value());
    const Pack& pack = cuda_pack();
    CHECK(pack.abi == pack_abi);
    CHECK(std::string(pack.target) == "cuda");
    CHECK(pack.variant_count == (*registry)->variants().size());
    for (std::uint32_t i = 0; i < pack.variant_count; ++i) {
        const PackVariant& variant = pack.variants[i];
        CAPTURE(variant.name);
        CHECK((*registry)->find(variant.name) != nullptr);
        const auto& queries = variant.trace[traversal_single];
        for (const Query query : {query_closest, query_any, query_multi}) {
            // Outputs depend on the order of the traversal, so these intersectors run on the CPU.
            CHECK((queries[query][0] != nullptr) == (variant.output_count == 0));
            CHECK((queries[query][1] == nullptr));  // counters exist only on the CPU
        }
    }
}

TEST_CASE("the registry loads the cuda pack only on request") {
    Registry::Options options;
    options.pack_dirs = {std::filesystem::path(RAYNEST_CUDA_PACK).parent_path()};
    const auto any = Registry::load(options);
    REQUIRE(any.has_value());
    for (const Pack* pack : (*any)->packs()) CHECK(std::string(pack->target) != "cuda");

    options.target = "cuda";
    const auto cuda = Registry::load(options);
    CHECK(cuda.has_value() == cuda_pack().supported());
    if (!cuda) {
        CHECK(cuda.error().message.find("this machine does not run target cuda") == 0);
    }
}

TEST_CASE("a call is answered, or reports that there is no GPU") {
    const auto snapshot = Snapshot::build(conformance::nested_scene(2, 1));
    REQUIRE(snapshot.has_value());
    conformance::Random random(1);
    const std::vector<Ray> rays = conformance::random_rays(300, 8, random);
    std::vector<HitRecord> hits(rays.size());
    TraceCall call{};
    call.scene = &(*snapshot)->view();
    call.rays = rays.data();
    call.ray_count = static_cast<std::uint32_t>(rays.size());
    call.hits_max = 1;
    call.mask = 0xFFFFFFFFU;
    call.hits = hits.data();
    const Pack& pack = cuda_pack();
    const TraceFunction closest = pack.variants[0].trace[traversal_single][query_closest][0];
    CHECK(closest(&call) == (pack.supported() ? trace_ok : trace_no_device));

    call.hits = nullptr;
    CHECK(closest(&call) == trace_bad_call);
}
