// Tests the device entry points of a pack: every kernel over loaded scenes and over scenes made of
// others and their changes, two calls in flight, with rays from the host and rays that the device
// makes, against the bytes of the CPU's pack. The work is small, so that compute-sanitizer finishes.
// RAYNEST_DEVICE_PACK names the pack.
#include "engine/cuda/limits.h"
#include "engine/packs/load.h"
#include "engine/packs/registry.h"
#include "engine/scene/edits/edit.h"
#include "engine/scene/snapshot.h"
#include "server/backends/cuda/scene_changes.h"
#include "tests/conformance/scenes.h"

#include <doctest/doctest.h>

#include <array>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <optional>
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

using Slot = std::unique_ptr<DeviceSlot, void (*)(DeviceSlot*) noexcept>;
using Scene = std::unique_ptr<DeviceScene, void (*)(DeviceScene*) noexcept>;
using Epoch = std::shared_ptr<const Snapshot>;

/// A device with two slots, and the CPU's kernels beside it.
class Bench {
public:
    /// Returns nothing, and says why, without a GPU or without kernels to compare with.
    static std::optional<Bench> open() {
        const char* const path = std::getenv("RAYNEST_DEVICE_PACK");
        REQUIRE((path != nullptr));
        auto pack = load_device_pack(path);
        REQUIRE_MESSAGE(pack.has_value(), pack.error().message);
        DeviceInfo info{};
        if (pack->device->open(&info) != trace_ok) {
            MESSAGE("skipped: no GPU: " << std::string(pack->device->error()));
            return std::nullopt;
        }
        MESSAGE("on " << info.name);
        Registry::Options options;
        options.target = "v3";
        auto registry = Registry::load(options);
        if (!registry) {
            MESSAGE("skipped: no GPU to compare with v3: " << registry.error().message);
            return std::nullopt;
        }
        return Bench(*pack, std::move(*registry));
    }

    [[nodiscard]] const Device& device() const { return *pack_.device; }

    [[nodiscard]] Scene load(const Snapshot& scene) const {
        DeviceScene* loaded = nullptr;
        REQUIRE(device().load(&scene.view(), &loaded) == trace_ok);
        return {loaded, device().unload};
    }
    /// Makes an edited scene of one that it was edited from.
    [[nodiscard]] Scene load_changed(const Scene& base, const Snapshot& before,
                                     const Snapshot& scene) const {
        const auto from =
            scene.edited_from([&](const std::string& id) { return id == before.arena_id(); });
        REQUIRE(from.has_value());
        const auto heads = server::device::changed_ranges(scene.bytes(), from->changed);
        const auto file = server::device::changes_file(scene.bytes(), heads);
        const auto ranges = server::device::read_changes(file);
        REQUIRE_MESSAGE(ranges.has_value(), ranges.error().message);
        DeviceScene* loaded = nullptr;
        REQUIRE(device().load_changed(base.get(), ranges->data(),
                                      static_cast<std::uint32_t>(ranges->size()),
                                      &loaded) == trace_ok);
        return {loaded, device().unload};
    }

    /// Compares every kernel, over random rays and those of cameras. Returns how many calls.
    std::uint32_t compare(const SceneDescription& description, const Snapshot& snapshot,
                          const Scene& scene) const {
        const std::array cameras{camera(false), camera(true)};
        std::uint32_t kernels = 0;
        for (const PackVariant& variant :
             std::span(pack_.pack->variants, pack_.pack->variant_count)) {
            CAPTURE(std::string(variant.name));
            for (const Question& question : questions(description, cameras)) {
                for (const Query query : {query_closest, query_any, query_multi}) {
                    CAPTURE(query);
                    kernels += compare(variant, question, query, snapshot.view(), scene);
                }
            }
        }
        return kernels;
    }

private:
    Bench(const DevicePack& pack, std::shared_ptr<const Registry> registry)
        : pack_(pack),
          registry_(std::move(registry)),
          slots_{make_slot(), make_slot()} {}

    [[nodiscard]] Slot make_slot() const {
        DeviceSlot* slot = nullptr;
        REQUIRE(device().make_slot(rays_max, rays_max * multi_hits, &slot) == trace_ok);
        return {slot, device().free_slot};
    }

    [[nodiscard]] std::uint32_t compare(const PackVariant& variant, const Question& question,
                                        Query query, const SceneView& view,
                                        const Scene& scene) const {
        const TraceFunction kernel = variant.trace[traversal_single][query][0];
        if (kernel == nullptr) return 0;
        Answers expected;
        TraceCall call = expected.call(query);
        call.scene = &view;
        call.rays = question.rays.data();
        const Variant* const cpu = registry_->find(variant.name);
        REQUIRE((cpu != nullptr));
        REQUIRE(cpu->code->trace[traversal_single][query][0](&call) == trace_ok);
        std::array<Answers, 2> answers;
        for (std::size_t i = 0; i < slots_.size(); ++i) {
            call = answers[i].call(query);
            if (question.made == nullptr) call.rays = question.rays.data();
            REQUIRE(device().start(slots_[i].get(), scene.get(), kernel, &call, question.made) ==
                    trace_ok);
        }
        for (std::size_t i = 0; i < slots_.size(); ++i) {
            REQUIRE(device().finish(slots_[i].get()) == trace_ok);
            CHECK(differing_rays(answers[i], expected, query) == 0);
        }
        std::uint32_t hits = 0;
        for (const HitRecord& hit : expected.hits) hits += hit.hit;
        CHECK(hits > 0);
        return 1;
    }

    DevicePack pack_;
    std::shared_ptr<const Registry> registry_;
    std::array<Slot, 2> slots_;
};

Epoch edited(const Snapshot& scene, const SceneChanges& changes) {
    auto edited = edit_scene(scene, changes);
    REQUIRE_MESSAGE(edited.has_value(), edited.error().message);
    return *edited;
}

/// Moves an outermost instance along x.
Epoch moved(const Snapshot& scene, std::uint32_t instance) {
    const SceneView& view = scene.view();
    Transform to = view.instance_infos[view.objects[view.root].first_instance + instance].to_parent;
    to.m[3] += 0.5F;
    return edited(scene, {.moves = {{instance, to}}});
}

}  // namespace

TEST_CASE("through slots every kernel gives the CPU's bytes") {
    const auto bench = Bench::open();
    if (!bench) return;
    const SceneDescription scenes[] = {conformance::nested_scene(1, 1),
                                       conformance::nested_scene(cuda::levels_max, 1),
                                       conformance::sphere_scene(5)};
    std::uint32_t kernels = 0;
    for (const SceneDescription& description : scenes) {
        const auto snapshot = Snapshot::build(description);
        REQUIRE(snapshot.has_value());
        kernels += bench->compare(description, **snapshot, bench->load(**snapshot));
    }
    CHECK(kernels >= 3 * 3 * 3 * 3);
    MESSAGE(kernels << " kernels compared");
}

TEST_CASE("a scene made of another and its changes gives the CPU's bytes, and so does the other") {
    const auto bench = Bench::open();
    if (!bench) return;
    const SceneDescription description = conformance::nested_scene(3, 1);
    const auto built = Snapshot::build(description);
    REQUIRE(built.has_value());
    Scene first = bench->load(**built);
    const Epoch one = moved(**built, 0);
    const Epoch two = moved(*one, 1);
    const Scene changed = bench->load_changed(first, **built, *one);
    bench->compare(description, **built, first);
    bench->compare(description, *one, changed);
    // Two edits at once, after the scene that it shares arrays with is gone.
    const Scene later = bench->load_changed(first, **built, *two);
    first.reset();
    bench->compare(description, *two, later);

    const SceneView& view = two->view();
    const InstancePlace mesh(0);
    std::uint32_t vertices = 0;
    const ObjectRecord& object =
        view.objects[view.instances[view.objects[view.root].first_instance].object];
    for (std::uint32_t g = 0; g < object.geometry_count; ++g)
        vertices += view.geometries[object.first_geometry + g].vertex_count;
    conformance::Random random(7);
    std::vector<Vec3> positions;
    for (std::uint32_t i = 0; i < vertices; ++i) positions.push_back(random.in_box(4));
    // A mesh that is placed several times gets an object of its own: another layout, sent whole.
    const Epoch apart = edited(*two, {.deformed = {{mesh, {positions}}}});
    for (Vec3& position : positions) position.y += 0.5F;
    const Epoch deformed = edited(*apart, {.deformed = {{mesh, {positions}}}});
    const Scene alone = bench->load(*apart);
    bench->compare(description, *deformed, bench->load_changed(alone, *apart, *deformed));
}

TEST_CASE("a moved instance costs the device what has changed") {
    const auto bench = Bench::open();
    if (!bench) return;
    SceneDescription description = conformance::sheet_scene(20'000, 1, 1);
    description.objects.emplace_back();
    for (std::uint32_t i = 0; i < 5000; ++i) {
        InstanceDescription instance;
        instance.object = 0;
        instance.transform.m[3] = static_cast<float>(i);
        description.objects[1].instances.push_back(instance);
    }
    description.root = 1;
    const auto built = Snapshot::build(description);
    REQUIRE(built.has_value());
    const Device& device = bench->device();
    const std::uint64_t before = device.scene_bytes();
    Scene base = bench->load(**built);
    const std::uint64_t whole = device.scene_bytes() - before;
    CHECK(device.copied_bytes(base.get()) == whole);
    const Epoch one = moved(**built, 2000);
    Scene changed = bench->load_changed(base, **built, *one);
    MESSAGE(device.copied_bytes(changed.get()) << " of " << whole << " bytes are copied");
    CHECK(device.copied_bytes(changed.get()) < whole / 50);
    // The meshes are shared; the root's nodes and instances are not.
    CHECK(device.scene_bytes() - before < whole + whole / 2);
    base.reset();
    CHECK(device.scene_bytes() - before == whole);
    changed.reset();
    CHECK(device.scene_bytes() == before);
}

TEST_CASE("changes that a scene has no place for are refused") {
    const auto bench = Bench::open();
    if (!bench) return;
    const auto built = Snapshot::build(conformance::nested_scene(2, 1));
    REQUIRE(built.has_value());
    const Scene base = bench->load(**built);
    const SceneView& view = (*built)->view();
    const auto status = [&](const ChangedRange& range) {
        DeviceScene* loaded = nullptr;
        const TraceStatus made = bench->device().load_changed(base.get(), &range, 1, &loaded);
        const Scene scene(loaded, bench->device().unload);
        CHECK((scene == nullptr) == (made != trace_ok));
        return made;
    };
    const std::uint64_t count = view.instance_count;
    CHECK(status({array_instances, 0, count, view.instances}) == trace_ok);
    CHECK(status({array_instances, 1, count, view.instances}) == trace_bad_call);
    CHECK(status({array_instances, count + 1, 0, view.instances}) == trace_bad_call);
    CHECK(status({array_instances, 1, ~0ULL, view.instances}) == trace_bad_call);
    CHECK(status({array_count, 0, 1, view.instances}) == trace_bad_call);
    // Kernels read no attributes behind those on the device.
    CHECK(status({array_attributes, ~0ULL, 1, view.attributes}) == trace_ok);
}
