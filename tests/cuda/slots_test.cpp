// Tests the device entry points of a pack: every kernel over loaded scenes, two calls in flight,
// with rays from the host and rays that the device makes, against the bytes of the CPU's pack. The
// work is small, so that compute-sanitizer finishes. RAYNEST_DEVICE_PACK names the pack.
#include "engine/cuda/limits.h"
#include "engine/packs/load.h"
#include "engine/packs/registry.h"
#include "engine/scene/snapshot.h"
#include "tests/conformance/scenes.h"

#include <doctest/doctest.h>

#include <array>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <span>
#include <string>
#include <vector>

using namespace raynest;

namespace {

constexpr std::uint32_t rays_max = 300;  // the last block of threads is not full
constexpr std::uint32_t multi_hits = 5;

struct Answers {
    std::vector<HitRecord> hits{std::size_t{rays_max} * multi_hits};
    std::vector<std::uint32_t> counts = std::vector<std::uint32_t>(rays_max);

    TraceCall call(Query query) {
        TraceCall call{};
        call.ray_count = rays_max;
        call.hits_max = query == query_multi ? multi_hits : 1;
        call.mask = 0xFFFFFFFFU;
        call.hits = hits.data();
        call.hit_counts = counts.data();
        return call;
    }
};

std::uint32_t differing_rays(const Answers& a, const Answers& b, Query query) {
    std::uint32_t differing = 0;
    for (std::size_t i = 0; i < rays_max; ++i) {
        const bool multi = query == query_multi;
        const std::size_t first = multi ? i * multi_hits : i;
        const std::size_t filled = multi ? a.counts[i] : 1;
        if ((multi && a.counts[i] != b.counts[i]) || filled > multi_hits ||
            std::memcmp(&a.hits[first], &b.hits[first], filled * sizeof(HitRecord)) != 0)
            ++differing;
    }
    return differing;
}

/// Returns camera rays into the middle of a scene, which start within the picture.
PinholeRays camera(bool tiles) {
    Pinhole pinhole;
    pinhole.sensor_pose.pose.origin = {1, 2, 12};
    pinhole.size = {25, 17};
    pinhole.center_x = 12.5;
    pinhole.center_y = 8.5;
    pinhole.step_x = pinhole.step_y = 0.08;
    return {pinhole, 100, tiles};
}

/// A call to the device, and the same call on the CPU.
struct Question {
    const PinholeRays* made;
    std::vector<Ray> rays;
};

std::vector<Question> questions(const SceneDescription& scene,
                                std::span<const PinholeRays> cameras) {
    conformance::Random random(3);
    const bool triangles = !scene.objects[scene.root].geometries.empty();
    std::vector<Question> all{{nullptr, triangles
                                            ? conformance::edge_rays(scene, rays_max, 8, random)
                                            : conformance::random_rays(rays_max, 8, random)}};
    for (const PinholeRays& made : cameras) {
        all.push_back({&made, {}});
        for (std::uint32_t i = 0; i < rays_max; ++i) all.back().rays.push_back(made.ray(i));
    }
    return all;
}

}  // namespace

TEST_CASE("through slots every kernel gives the CPU's bytes") {
    const char* const path = std::getenv("RAYNEST_DEVICE_PACK");
    REQUIRE((path != nullptr));
    const auto device_pack = load_device_pack(path);
    REQUIRE_MESSAGE(device_pack.has_value(), device_pack.error().message);
    const Device& device = *device_pack->device;
    DeviceInfo info{};
    if (device.open(&info) != trace_ok) {
        MESSAGE("skipped: no GPU: " << std::string(device.error()));
        return;
    }
    MESSAGE("on " << info.name);
    Registry::Options options;
    options.target = "v3";
    const auto registry = Registry::load(options);
    if (!registry) {
        MESSAGE("skipped: no GPU to compare with v3: " << registry.error().message);
        return;
    }

    using Slot = std::unique_ptr<DeviceSlot, void (*)(DeviceSlot*) noexcept>;
    const auto make_slot = [&] {
        DeviceSlot* slot = nullptr;
        REQUIRE(device.make_slot(rays_max, rays_max * multi_hits, &slot) == trace_ok);
        return Slot(slot, device.free_slot);
    };
    const std::array<Slot, 2> slots{make_slot(), make_slot()};
    const std::array cameras{camera(false), camera(true)};
    const SceneDescription scenes[] = {conformance::nested_scene(1, 1),
                                       conformance::nested_scene(cuda::levels_max, 1),
                                       conformance::sphere_scene(5)};
    std::uint32_t kernels = 0;
    for (const SceneDescription& description : scenes) {
        const auto snapshot = Snapshot::build(description);
        REQUIRE(snapshot.has_value());
        const SceneView& view = (*snapshot)->view();
        DeviceScene* loaded = nullptr;
        REQUIRE(device.load(&view, &loaded) == trace_ok);
        const std::unique_ptr<DeviceScene, void (*)(DeviceScene*) noexcept> scene(loaded,
                                                                                  device.unload);
        const auto compare = [&](const PackVariant& variant, const Question& question,
                                 Query query) {
            const TraceFunction kernel = variant.trace[traversal_single][query][0];
            if (kernel == nullptr) return;
            ++kernels;
            Answers expected;
            TraceCall call = expected.call(query);
            call.scene = &view;
            call.rays = question.rays.data();
            const Variant* const cpu = (*registry)->find(variant.name);
            REQUIRE((cpu != nullptr));
            REQUIRE(cpu->code->trace[traversal_single][query][0](&call) == trace_ok);
            std::array<Answers, 2> answers;
            for (std::size_t i = 0; i < slots.size(); ++i) {
                call = answers[i].call(query);
                if (question.made == nullptr) call.rays = question.rays.data();
                REQUIRE(device.start(slots[i].get(), scene.get(), kernel, &call, question.made) ==
                        trace_ok);
            }
            for (std::size_t i = 0; i < slots.size(); ++i) {
                REQUIRE(device.finish(slots[i].get()) == trace_ok);
                CHECK(differing_rays(answers[i], expected, query) == 0);
            }
            std::uint32_t hits = 0;
            for (const HitRecord& hit : expected.hits) hits += hit.hit;
            CHECK(hits > 0);
        };
        for (const PackVariant& variant :
             std::span(device_pack->pack->variants, device_pack->pack->variant_count)) {
            CAPTURE(std::string(variant.name));
            for (const Question& question : questions(description, cameras)) {
                for (const Query query : {query_closest, query_any, query_multi}) {
                    CAPTURE(query);
                    compare(variant, question, query);
                }
            }
        }
    }
    CHECK(kernels >= 3 * 3 * 3 * 3);
    MESSAGE(kernels << " kernels compared");
}
