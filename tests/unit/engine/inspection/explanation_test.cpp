// Observers are told what counters count: the totals of an explanation are compared with
// the counting kernel's, ray by ray.
#include "engine/inspection/explanation.h"

#include "engine/packs/kernel_selector.h"
#include "engine/packs/registry.h"
#include "tests/conformance/answers.h"
#include "tests/conformance/scenes.h"
#include "tests/unit/engine/builtin_packs.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstring>
#include <limits>
#include <vector>

using namespace raynest;
using test::registry;

namespace {

Explanation explain(const Variant& variant, const Snapshot& scene, const Ray& ray,
                    const Settings& settings, std::uint32_t mask = 0xFFFFFFFFU,
                    std::size_t entries_max = 1U << 20) {
    ExplanationRecorder recorder(scene, entries_max);
    HitRecord hit;
    TraceCall call{};
    call.scene = &scene.view();
    call.params = settings.params.empty() ? nullptr : settings.params.data();
    call.flags = settings.flags;
    call.mask = mask;
    call.rays = &ray;
    call.ray_count = 1;
    call.hits_max = 1;
    call.hits = &hit;
    call.observer = &recorder.observer();
    const auto selector = KernelSelector::observing(variant).value();
    REQUIRE(selector.function(selector.choose({&ray, 1}, scene.view()))(&call) == trace_ok);
    Explanation told = recorder.take();
    CHECK(conformance::same_bytes({&told.hit, 1}, {&hit, 1}));
    return told;
}

bool same(const Counters& a, const Counters& b) {
    return std::memcmp(&a, &b, sizeof a) == 0;
}

Counters sum(const std::vector<Counters>& levels) {
    Counters all;
    for (const Counters& level : levels) {
#define RAYNEST_COUNTER(name, title) all.name += level.name;
#define RAYNEST_SUM(...)
#include "engine/geometry/counters.def"
    }
    return all;
}

std::size_t entries_of(const Explanation& told, EntryKind kind, StepOutcome outcome) {
    return static_cast<std::size_t>(
        std::ranges::count_if(told.entries, [&](const ExplainedEntry& entry) {
            return entry.kind == kind && entry.outcome == outcome;
        }));
}

/// Entries say by themselves what the totals count.
Counters count_entries(const Explanation& told) {
    Counters counted;
    for (const ExplainedEntry& entry : told.entries) {
        switch (entry.kind) {
            case EntryKind::node:
                ++counted.nodes;
                counted.boxes += entry.tested;
                break;
            case EntryKind::leaf:
                ++counted.leaves;
                counted.prims += entry.tested;
                counted.rejects += entry.refused;
                break;
            case EntryKind::instance:
                counted.instances += entry.outcome == outcome_accepted ? 1 : 0;
                break;
            case EntryKind::candidate:
                break;
        }
    }
    return counted;
}

}  // namespace

TEST_CASE("an explanation that is cut off names no earlier hit as the hit") {
    conformance::Random random(12);
    const auto scene = test::build_scene(conformance::nested_scene(2, 2));
    std::size_t cut = 0;
    for (const Ray& ray : conformance::random_rays(300, 6, random)) {
        const std::size_t all = explain(*registry().find("opaque"), *scene, ray, {}).entries.size();
        for (std::size_t entries_max = 1; entries_max < all; ++entries_max) {
            const Explanation told =
                explain(*registry().find("opaque"), *scene, ray, {}, 0xFFFFFFFFU, entries_max);
            cut += told.hit.hit != 0 && told.hit_entry == no_id ? 1 : 0;
            if (told.hit_entry != no_id) CHECK(told.entries[told.hit_entry].t == told.hit.t);
        }
    }
    CHECK(cut != 0);
}

TEST_CASE("an explanation's totals are the counters of its ray") {
    conformance::Random random(11);
    for (const std::uint32_t depth : {1U, 2U, 3U, 4U}) {
        const SceneDescription description = conformance::nested_scene(depth, depth);
        const auto scene = test::build_scene(description);
        std::vector<Ray> rays = conformance::random_rays(150, 6, random);
        for (const auto& more : {conformance::edge_rays(description, 60, 6, random),
                                 conformance::odd_rays(60, 6, random)})
            rays.insert(rays.end(), more.begin(), more.end());
        for (const Variant& variant : registry().variants()) {
            for (const char* cull : {"none", "back"}) {
                CAPTURE(depth);
                CAPTURE(variant.name);
                CAPTURE(cull);
                const Settings settings =
                    parse_settings(variant, {{{"cull", std::string(cull)}}}).value();
                const auto counting =
                    KernelSelector::make(variant, query_closest, traversal_single, counters_total)
                        .value();
                const conformance::Answer counted =
                    conformance::ask(variant, counting.function(traversal_single), scene->view(),
                                     rays, {query_closest, 1}, settings);
                std::size_t refused = 0;
                for (std::size_t i = 0; i < rays.size(); ++i) {
                    const Explanation told = explain(variant, *scene, rays[i], settings);
                    CHECK(same(told.totals, counted.counters[i]));
                    CHECK(same(sum(told.levels), told.totals));
                    CHECK(conformance::same_bytes({&told.hit, 1}, counted.of(i)));
                    if (!is_valid(rays[i])) continue;
                    const Counters entries = count_entries(told);
                    CHECK(entries.nodes == told.totals.nodes);
                    CHECK(entries.boxes == told.totals.boxes);
                    CHECK(entries.leaves == told.totals.leaves);
                    CHECK(entries.prims == told.totals.prims);
                    CHECK(entries.rejects == told.totals.rejects);
                    CHECK(entries.instances == told.totals.instances);
                    const std::size_t by_intersector =
                        entries_of(told, EntryKind::candidate, outcome_refused);
                    CHECK(by_intersector == told.totals.rejects);
                    refused += by_intersector;
                    CHECK((told.hit_entry != no_id) == (told.hit.hit != 0));
                    if (told.hit_entry != no_id) {
                        const ExplainedEntry& hit = told.entries[told.hit_entry];
                        CHECK(hit.t == told.hit.t);
                        CHECK(hit.place == told.hit.triangle);
                        CHECK(hit.placements.first == told.hit.path);
                    }
                }
                CHECK((refused != 0) == (variant.name != "opaque"));
            }
        }
    }
}

TEST_CASE("parents come before their children, boxes hold the world") {
    const auto scene = test::build_scene(conformance::nested_scene(3, 5));
    conformance::Random random(3);
    const Variant& opaque = *registry().find("opaque");
    const Settings settings = parse_settings(opaque, {}).value();
    std::size_t instances = 0;
    for (const Ray& ray : conformance::random_rays(100, 6, random)) {
        const Explanation told = explain(opaque, *scene, ray, settings);
        std::vector<std::uint32_t> children(told.entries.size(), 0);
        for (const ExplainedEntry& entry : told.entries)
            if (entry.parent != no_id) ++children[entry.parent];
        for (std::size_t i = 0; i < told.entries.size(); ++i) {
            const ExplainedEntry& entry = told.entries[i];
            if (entry.kind == EntryKind::node) CHECK(entry.passed == children[i] + entry.behind);
            if (entry.parent == no_id) {
                CHECK(entry.level == 0);
            } else {
                REQUIRE(entry.parent < i);
                const ExplainedEntry& parent = told.entries[entry.parent];
                CHECK(entry.level == parent.level + (entry.kind == EntryKind::instance ? 1 : 0));
            }
            if (entry.kind == EntryKind::candidate) continue;
            instances += entry.kind == EntryKind::instance ? 1 : 0;
            // The ray enters the box where it says, but for the padding of boxes.
            CAPTURE(static_cast<int>(entry.kind));
            CAPTURE(entry.level);
            CAPTURE(entry.place);
            CAPTURE(entry.near);
            CAPTURE(ray.tmin);
            const Vec3 at = point_along(ray.origin, ray.direction, entry.near);
            const Vec3 slack = 1e-3F * (entry.box.size() + Vec3(1));
            for (int axis = 0; axis < 3 && entry.parent != no_id; ++axis) {
                CHECK(at[axis] >= entry.box.lower[axis] - slack[axis]);
                CHECK(at[axis] <= entry.box.upper[axis] + slack[axis]);
            }
        }
    }
    CHECK(instances != 0);
}

TEST_CASE("candidates and instances say why they were refused") {
    // Two squares, one behind the other, the nearer one single-sided; a third one is masked out.
    SceneDescription description;
    description.materials.resize(1);
    description.materials[0].name = "glass";
    description.objects.resize(2);
    description.objects[0].name = "pane";
    description.objects[0].geometries = {test::unit_square(0)};
    description.objects[1].instances = {test::place(0, test::translation(0, 0, 0), "far"),
                                        test::place(0, test::translation(0, 0, 2), "near"),
                                        test::place(0, test::translation(0, 0, 4), "hidden")};
    description.objects[1].instances[2].mask = 2;
    description.root = 1;
    const auto scene = test::build_scene(description);
    const Variant& opaque = *registry().find("opaque");
    const Ray from_front{Vec3(0.3F, 0.2F, 9), 0, Vec3(0, 0, -1),
                         std::numeric_limits<float>::infinity()};
    const Settings plain = parse_settings(opaque, {}).value();
    const Explanation told = explain(opaque, *scene, from_front, plain, 1);
    CHECK(entries_of(told, EntryKind::instance, outcome_masked) == 1);
    CHECK(told.hit.t == 7);
    CHECK(entries_of(told, EntryKind::candidate, outcome_accepted) == 1);

    const Ray from_back{Vec3(0.3F, 0.2F, -9), 0, Vec3(0, 0, 1),
                        std::numeric_limits<float>::infinity()};
    const Settings culling = parse_settings(opaque, {{{"cull", "back"}}}).value();
    const Explanation culled = explain(opaque, *scene, from_back, culling, 1);
    CHECK(culled.hit.hit == 0);
    CHECK(culled.hit_entry == no_id);
    CHECK(entries_of(culled, EntryKind::candidate, outcome_culled) == 2);

    CHECK(instance_path(*scene, {1, 1}, 1) == "near");
}

TEST_CASE("a long explanation keeps its first entries and counts the others") {
    const auto scene = test::build_scene(conformance::nested_scene(3, 5));
    conformance::Random random(3);
    const Variant& variant = *registry().find("alpha_mask");
    const Settings settings = parse_settings(variant, {}).value();
    std::size_t cut_rays = 0;
    for (const Ray& ray : conformance::random_rays(50, 6, random)) {
        const Explanation whole = explain(variant, *scene, ray, settings);
        const Explanation cut = explain(variant, *scene, ray, settings, 0xFFFFFFFFU, 5);
        CHECK(same(cut.totals, whole.totals));
        std::uint64_t left_out = 0;
        for (const std::uint64_t count : cut.left_out) left_out += count;
        CHECK(cut.entries.size() + left_out == whole.entries.size());
        CHECK(cut.entries.size() == std::min<std::size_t>(5, whole.entries.size()));
        for (std::size_t i = 0; i < cut.entries.size(); ++i) {
            CHECK(cut.entries[i].place == whole.entries[i].place);
            CHECK(cut.entries[i].behind == whole.entries[i].behind);
        }
        if (cut.hit_entry != no_id) CHECK(cut.hit_entry == whole.hit_entry);
        cut_rays += left_out != 0 ? 1 : 0;
    }
    CHECK(cut_rays > 10);
}
