// Tests the choice of a variant and the checks of a request's settings.
#include "engine/packs/registry.h"

#include "engine/packs/kernel_selector.h"

#include <doctest/doctest.h>

#include <string>
#include <utility>
#include <vector>

using namespace raynest;

namespace {

std::shared_ptr<const Registry> registry_for(const char* target) {
    auto registry = Registry::load({{}, target});
    REQUIRE_MESSAGE(registry.has_value(), (registry ? "" : registry.error().message));
    return *registry;
}

std::string message_of(const Variant& variant, const char* key, const char* value) {
    const std::vector<std::pair<std::string, std::string>> assignment{{key, value}};
    const auto settings = parse_settings(variant, assignment);
    CHECK(!settings);
    if (settings) return "";
    CHECK(settings.error().code == ErrorCode::param_invalid);
    return settings.error().message;
}

}  // namespace

TEST_CASE("the best target comes first and --target forces one") {
    const auto best = registry_for("auto");
    const Variant* opaque = best->find("opaque");
    REQUIRE(opaque != nullptr);
    CHECK(opaque->targets.front() == opaque->target);
    const std::string least = opaque->targets.back();
    const auto forced = registry_for(least.c_str());
    CHECK(forced->find("opaque")->target == least);
    CHECK(forced->find("opaque")->targets.size() == 1);
}

TEST_CASE("an unknown target, pack directory or variant is an error that names the choice") {
    CHECK(Registry::load({{}, "v9"}).error().message ==
          "unknown target 'v9': use one of auto, v2, v3, v4");
    const auto missing = Registry::load({{"/nonexistent/packs"}, "auto"});
    CHECK(missing.error().code == ErrorCode::pack_invalid);
    const auto registry = registry_for("auto");
    SceneView empty;
    const auto unknown = registry->choose("alpha", empty);
    CHECK(unknown.error().code == ErrorCode::variant_unknown);
    CHECK(unknown.error().message.find("opaque") != std::string::npos);
}

TEST_CASE("two packs of one target with the same intersector refuse to load") {
    // Load the built-in directory a second time.
    const char* builtin = std::getenv("RAYNEST_BUILTIN_PACKS");
    REQUIRE(builtin != nullptr);
    const auto twice = Registry::load({{builtin}, "auto"});
    REQUIRE(!twice);
    CHECK(twice.error().message.find("both have an intersector named") != std::string::npos);
    CHECK(twice.error().message.starts_with(builtin));  // the file
}

TEST_CASE("two packs with primitives of one name and two sizes refuse to load") {
    const auto odd = Registry::load({{RAYNEST_TEST_ODD_PACK}, "auto"});
    REQUIRE(!odd);
    CHECK(odd.error().code == ErrorCode::pack_invalid);
    CHECK(odd.error().message.find("a primitive named 'sphere'") != std::string::npos);
}

TEST_CASE("auto is a variant that knows the scene's primitives, wherever the packs lie") {
    const char* builtin = std::getenv("RAYNEST_BUILTIN_PACKS");
    REQUIRE(builtin != nullptr);
    const auto registry = Registry::load({{}, "auto", builtin});
    REQUIRE(registry.has_value());
    const auto nowhere = Registry::load({{}, "auto", "/nonexistent"});
    CHECK(nowhere.error().message.find("/nonexistent") != std::string::npos);

    ObjectRecord root{};
    SceneView scene;
    scene.objects = &root;
    scene.object_count = 1;
    CHECK((*(*registry)->choose("auto", scene))->name == "opaque");
    // Queries see panes; only a mask makes holes.
    scene.masked_materials = scene.blended_materials = 2;
    CHECK((*(*registry)->choose("auto", scene))->name == "opaque");
    scene.blended_materials = 1;
    CHECK((*(*registry)->choose("auto", scene))->name == "alpha_mask");
    scene.masked_materials = scene.blended_materials = 0;
    root.record_type = primitive_type("sphere");
    root.record_size = sizeof(float) * 4;
    root.record_count = 1;
    CHECK((*(*registry)->choose("auto", scene))->name == "opaque");
    root.record_type = primitive_type("disc");
    CHECK((*registry)->choose("auto", scene).error().message ==
          "intersector 'opaque' was not compiled for primitives of type #" +
              std::to_string(root.record_type) + ": load the pack that has it");
}

TEST_CASE("parameters are checked by name, type, range and choice") {
    const auto registry = registry_for("auto");
    const Variant& mask = *registry->find("procedural_mask");
    CHECK(message_of(mask, "patern", "heart").find("pattern") != std::string::npos);
    CHECK(message_of(mask, "pattern", "star").find("heart, checker, discs, noise") !=
          std::string::npos);
    for (const char* bad : {"2", "-0.1", "nan", "inf", "", "0.5x", "1e999"}) {
        message_of(mask, "fill", bad);
    }
    message_of(mask, "seed", "1.5");
    message_of(mask, "seed", "4294967296");
    message_of(mask, "cull", "front");

    const std::vector<std::pair<std::string, std::string>> good{
        {"pattern", "heart"}, {"fill", "0.25"}, {"seed", "4294967295"}, {"cull", "back"}};
    const auto settings = parse_settings(mask, good);
    REQUIRE(settings.has_value());
    CHECK(settings->params.at(0) == 0);
    CHECK(settings->params.at(2) == 0.25);
    CHECK(settings->params.at(3) == 4294967295.0);
    CHECK(settings->flags == trace_cull_back);
}

TEST_CASE("a combination that was not compiled is refused with a remedy") {
    const auto registry = registry_for("auto");
    const Variant& opaque = *registry->find("opaque");
    CHECK(find_function(opaque, query_closest, traversal_single, counters_total).has_value());
    const auto missing = find_function(opaque, query_multi, traversal_packet);
    REQUIRE(!missing);
    CHECK(missing.error().message ==
          "kind multi of intersector 'opaque' has no traversal packet; it has single, stream, "
          "reference: leave `traversal` auto");
}

TEST_CASE("a malformed call is refused, not traced") {
    const auto registry = registry_for("auto");
    const auto function = find_function(*registry->find("opaque"), query_multi, traversal_single);
    TraceCall call{};
    CHECK((*function)(&call) == trace_bad_call);
    SceneView scene;
    Ray ray;
    HitRecord hit;
    call.scene = &scene;
    call.rays = &ray;
    call.hits = &hit;
    call.ray_count = 1;
    call.hits_max = multi_hits_max + 1;
    CHECK((*function)(&call) == trace_bad_call);

    const auto all = find_function(*registry->find("opaque"), query_all, traversal_single);
    std::uint32_t count = 0;
    std::uint32_t done = 0;
    std::uint8_t flags = 0;
    HitRecord room[8];
    call.hits = room;
    call.hit_counts = &count;
    call.ray_flags = &flags;
    call.rays_done = &done;
    call.ray_count = 0;
    call.hits_max = 4;
    call.hits_room = 8;
    CHECK((*all)(&call) == trace_ok);
    call.hits_room = 7;  // twice the budget is the least
    CHECK((*all)(&call) == trace_bad_call);
    call.hits_room = 8;
    call.rays_done = nullptr;
    CHECK((*all)(&call) == trace_bad_call);
}

TEST_CASE("traversal auto depends on the rays, a named one does not") {
    const auto registry = registry_for("v3");
    const Variant& opaque = *registry->find("opaque");
    ObjectRecord root{};
    root.bounds = {Vec3(-10), Vec3(10)};
    root.levels = 1;
    root.block_count = 1U << 14;  // a tree of 5 MiB
    SceneView scene;
    scene.objects = &root;
    scene.object_count = 1;

    std::vector<Ray> alike(256);
    for (std::size_t i = 0; i < alike.size(); ++i) {
        alike[i].direction = Vec3(0.0001F * static_cast<float>(i), 0, -1);
    }
    std::vector<Ray> apart = alike;
    for (std::size_t i = 0; i < apart.size(); ++i) {
        apart[i].direction = Vec3(i % 2 == 0 ? 1 : -1, 0.5F, i % 3 == 0 ? 1 : -1);
    }
    const auto make = [&](Query query, Traversal traversal, CounterMode counters) {
        const auto selector = KernelSelector::make(opaque, query, traversal, counters);
        REQUIRE(selector.has_value());
        return *selector;
    };

    const KernelSelector any_way = make(query_closest, traversal_auto, counters_none);
    CHECK(any_way.choose(alike, scene) == traversal_packet);
    CHECK(any_way.choose(apart, scene) == traversal_stream);
    CHECK(any_way.choose(std::span(alike).first(63), scene) == traversal_single);
    CHECK(any_way.choose(std::span(apart).first(63), scene) == traversal_single);

    ObjectRecord small_root = root;
    small_root.block_count = 1U << 12;
    SceneView small = scene;
    small.objects = &small_root;
    CHECK(any_way.choose(alike, small) == traversal_packet);
    CHECK(any_way.choose(apart, small) == traversal_single);

    ObjectRecord instanced_root = root;
    instanced_root.levels = 2;
    SceneView instanced = scene;
    instanced.objects = &instanced_root;
    CHECK(any_way.choose(alike, instanced) == traversal_packet);
    CHECK(any_way.choose(apart, instanced) == traversal_single);

    const KernelSelector named = make(query_closest, traversal_stream, counters_none);
    CHECK(named.choose(alike, scene) == traversal_stream);
    const KernelSelector counted = make(query_closest, traversal_auto, counters_total);
    CHECK(counted.choose(alike, scene) == traversal_single);
    const KernelSelector multi =
        make(query_multi, traversal_auto, counters_none);  // coherent has no multi
    CHECK(multi.choose(alike, scene) == traversal_single);
    CHECK(multi.choose(apart, scene) == traversal_stream);

    // A variant that overloads boxes: its packets are single rays, and reported as such.
    PackVariant code = *opaque.code;
    auto& compiled = code.trace;
    compiled[traversal_packet][query_closest][0] = compiled[traversal_single][query_closest][0];
    Variant boxes = opaque;
    boxes.code = &code;
    const auto selector = [&](Traversal traversal) {
        return KernelSelector::make(boxes, query_closest, traversal).value();
    };
    CHECK(selector(traversal_packet).choose(alike, scene) == traversal_single);
    CHECK(selector(traversal_auto).choose(alike, scene) == traversal_single);
    CHECK(selector(traversal_auto).choose(apart, scene) == traversal_stream);
}
