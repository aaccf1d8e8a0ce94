// Rankings add up, and each finding goes with its remedy, which lowers the work.
#include "engine/inspection/blame.h"

#include "engine/inspection/diagnosis.h"
#include "engine/inspection/explanation.h"
#include "engine/inspection/ranking.h"
#include "engine/packs/kernel_selector.h"
#include "engine/packs/registry.h"
#include "tests/conformance/scenes.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

using namespace raynest;

namespace {

const Variant& variant(const char* name) {
    static const auto loaded = Registry::load({}).value();
    return *loaded->find(name);
}

/// Watches rays in chunks of a size.
std::unique_ptr<Blame> watch(const Snapshot& scene, std::vector<Ray>& rays, const char* intersector,
                             std::uint32_t level = innermost_level, std::size_t chunk = 1000,
                             std::size_t rows_max = 1U << 20) {
    auto blame = std::make_unique<Blame>(scene, level, rows_max);
    const auto selector = KernelSelector::observing(variant(intersector)).value();
    std::vector<HitRecord> hits(rays.size());
    for (std::size_t first = 0; first < rays.size(); first += chunk) {
        BlameCollector collector(*blame);
        TraceCall call{};
        call.scene = &scene.view();
        call.mask = 0xFFFFFFFFU;
        call.rays = rays.data() + first;
        call.ray_count = static_cast<std::uint32_t>(std::min(chunk, rays.size() - first));
        call.hits_max = 1;
        call.hits = hits.data() + first;
        call.observer = &collector.observer();
        REQUIRE(selector.function(traversal_single)(&call) == trace_ok);
        collector.finish();
    }
    return blame;
}

/// All that the alpha mask does for one ray.
Explanation explain(const Snapshot& scene, const Ray& ray) {
    ExplanationRecorder recorder(scene, 1U << 20);
    HitRecord hit;
    TraceCall call{};
    call.scene = &scene.view();
    call.mask = 0xFFFFFFFFU;
    call.rays = &ray;
    call.ray_count = 1;
    call.hits_max = 1;
    call.hits = &hit;
    call.observer = &recorder.observer();
    const auto selector = KernelSelector::observing(variant("alpha_mask")).value();
    REQUIRE(selector.function(traversal_single)(&call) == trace_ok);
    return recorder.take();
}

/// Parallel rays down the z axis through the square of this half size, slightly oblique.
std::vector<Ray> grid(float half, int side) {
    std::vector<Ray> rays;
    for (int y = 0; y < side; ++y) {
        for (int x = 0; x < side; ++x) {
            const auto at = [&](int i) {
                return half * (2 * (static_cast<float>(i) + 0.5F) / static_cast<float>(side) - 1);
            };
            rays.push_back({Vec3(at(x), at(y), 50), 0, Vec3(0.011F, 0.007F, -1),
                            std::numeric_limits<float>::infinity()});
        }
    }
    return rays;
}

struct Seen {
    std::uint64_t work = 0;
    std::uint64_t instances = 0;
    std::vector<Finding> findings;
    [[nodiscard]] bool has(const std::string& name) const {
        return std::ranges::any_of(findings, [&](const Finding& f) { return f.name == name; });
    }
};

Seen look(const SceneDescription& description, const char* intersector = "opaque") {
    const auto scene = test::build_scene(description);
    std::vector<Ray> rays = grid(1, 40);
    const auto blame = watch(*scene, rays, intersector);
    Seen seen{blame->total().work(), 0, diagnose(*blame)};
    for (const auto& [key, work] : blame->rows(BlameTable::instances)) seen.instances += work.rays;
    for (const Finding& finding : seen.findings) {
        CHECK(finding.remedy.size() > 10);
        CHECK((finding.below ? finding.figure < finding.threshold
                             : finding.figure > finding.threshold));
    }
    return seen;
}

/// An object of triangles, each given by three corners.
ObjectDescription mesh(std::string name, const std::vector<Vec3>& corners,
                       std::uint32_t material = no_id) {
    GeometryDescription geometry;
    geometry.positions = corners;
    for (std::uint32_t i = 0; i < corners.size(); ++i) geometry.indices.push_back(i);
    geometry.material = material;
    ObjectDescription object;
    object.name = std::move(name);
    object.geometries = {geometry};
    return object;
}

/// A root with one instance of each of the objects before it.
SceneDescription placed(std::vector<ObjectDescription> objects) {
    SceneDescription scene;
    ObjectDescription root;
    for (std::uint32_t i = 0; i < objects.size(); ++i)
        root.instances.push_back(test::place(i, Transform{}, "part-" + std::to_string(i)));
    scene.objects = std::move(objects);
    scene.objects.push_back(root);
    scene.root = static_cast<std::uint32_t>(scene.objects.size() - 1);
    return scene;
}

/// Small triangles all over the square.
std::vector<Vec3> speckles(std::uint32_t count, std::uint64_t seed) {
    conformance::Random random(seed);
    std::vector<Vec3> corners;
    for (std::uint32_t i = 0; i < count; ++i) {
        const Vec3 at(random.between(-1, 1), random.between(-1, 1), random.between(-1, 1));
        for (const Vec3& side : {Vec3(0), Vec3(0.2F, 0, 0), Vec3(0, 0.2F, 0)})
            corners.push_back(at + side);
    }
    return corners;
}

/// A strip of triangles along the diagonal of a cube, in so many pieces.
std::vector<Vec3> needles(int pieces) {
    std::vector<Vec3> corners;
    const Vec3 along(2, 2, 2);
    for (int n = 0; n < 60; ++n) {
        const Vec3 start(-1 + 0.02F * static_cast<float>(n), -1,
                         -1 - 0.02F * static_cast<float>(n));
        const Vec3 width(0.03F, -0.03F, 0);
        for (int i = 0; i < pieces; ++i) {
            const Vec3 from = start + along * (static_cast<float>(i) / static_cast<float>(pieces));
            const Vec3 to =
                start + along * (static_cast<float>(i + 1) / static_cast<float>(pieces));
            for (const Vec3& corner : {from, to, to + width, from, to + width, from + width})
                corners.push_back(corner);
        }
    }
    return corners;
}

}  // namespace

TEST_CASE("a ranking's rows and its remainder are all of the work, whatever the chunks") {
    conformance::Random random(4);
    const auto scene = test::build_scene(conformance::nested_scene(4, 2));
    std::vector<Ray> rays = conformance::random_rays(400, 6, random);
    for (const std::uint32_t level : {innermost_level, 1U, 2U, 3U}) {
        CAPTURE(level);
        const auto one = watch(*scene, rays, "alpha_mask", level);
        const auto many = watch(*scene, rays, "alpha_mask", level, 37);
        CHECK(one->rays() == rays.size());
        for (const BlameTable table :
             {BlameTable::instances, BlameTable::meshes, BlameTable::materials}) {
            const Ranking a = rank(*one, table);
            const Ranking b = rank(*many, table);
            REQUIRE(a.rows.size() == b.rows.size());
            CHECK(a.rows.size() > 1);
            std::uint64_t sum = a.remainder;
            for (std::size_t i = 0; i < a.rows.size(); ++i) {
                const RankedRow& row = a.rows[i];
                CHECK(row.key == b.rows[i].key);
                CHECK(row.work.work() == b.rows[i].work.work());
                CHECK(row.work.wasted == b.rows[i].work.wasted);
                CHECK(row.work.rays == b.rows[i].work.rays);
                CHECK(row.work.hit_rays <= row.work.rays);
                CHECK(row.work.wasted <= row.work.work());
                if (i > 0) CHECK(row.ranked <= a.rows[i - 1].ranked);
                if (table == BlameTable::instances && level != innermost_level)
                    CHECK(row.key.depth == level);
                sum += row.ranked;
            }
            CHECK(sum == a.total);
            CHECK(a.total == one->total().boxes + one->total().prims);
        }
    }
}

TEST_CASE("rows are what the explanations of the rays add up to") {
    conformance::Random random(8);
    const auto scene = test::build_scene(conformance::nested_scene(4, 3));
    const SceneView& view = scene->view();
    std::vector<Ray> rays = conformance::random_rays(300, 6, random);
    for (const std::uint32_t level : {innermost_level, 1U, 2U}) {
        CAPTURE(level);
        std::map<std::pair<std::uint64_t, std::uint32_t>, BlamedWork> instances;
        std::map<std::uint32_t, BlamedWork> meshes;
        std::map<std::uint32_t, BlamedWork> materials;
        for (const Ray& ray : rays) {
            const Explanation told = explain(*scene, ray);
            const HitRecord& hit = told.hit;
            std::map<std::pair<std::uint64_t, std::uint32_t>, BlamedWork> seen;
            std::map<std::uint32_t, BlamedWork> seen_meshes;
            std::map<std::uint32_t, BlamedWork> seen_materials;
            std::map<std::pair<std::uint64_t, std::uint32_t>, PlacementRange> ranges;
            seen_meshes[view.root];
            for (std::size_t i = 0; i < told.entries.size(); ++i) {
                const ExplainedEntry& entry = told.entries[i];
                // The instances around the entry, innermost first.
                std::vector<const ExplainedEntry*> around;
                for (std::uint32_t at = static_cast<std::uint32_t>(i); at != no_id;
                     at = told.entries[at].parent) {
                    if (told.entries[at].kind == EntryKind::instance)
                        around.push_back(&told.entries[at]);
                }
                const auto place = [&]() -> BlamedWork* {
                    for (const ExplainedEntry* each : around) {
                        if (level != innermost_level && each->level != level) continue;
                        const std::pair key(each->placements.first, each->level);
                        ranges[key] = each->placements;
                        return &seen[key];
                    }
                    return nullptr;
                };
                if (entry.kind == EntryKind::instance && entry.outcome == outcome_accepted) {
                    place();
                    seen_meshes[entry.object];
                    const std::uint32_t parent = around.size() > 1 ? around[1]->object : view.root;
                    ++seen_meshes[parent].entered;
                    if (hit.hit != 0 && entry.placements.contains(hit.path))
                        ++seen_meshes[parent].needed;
                } else if (entry.kind == EntryKind::node) {
                    seen_meshes[entry.object].boxes += entry.tested;
                    if (BlamedWork* work = place()) work->boxes += entry.tested;
                } else if (entry.kind == EntryKind::leaf) {
                    seen_meshes[entry.object].prims += entry.tested;
                    if (BlamedWork* work = place()) work->prims += entry.tested;
                } else if (entry.kind == EntryKind::candidate && entry.outcome != outcome_behind) {
                    const auto material =
                        name_primitive(view, view.objects[entry.object], entry.place).material;
                    ++seen_materials[material].candidates;
                    if (entry.outcome == outcome_refused) ++seen_materials[material].refused;
                }
            }
            const auto end = [&](BlamedWork& sum, BlamedWork ray_work, bool has_hit) {
                ray_work.rays = 1;
                ray_work.hit_rays = has_hit ? 1 : 0;
                ray_work.wasted = has_hit ? 0 : ray_work.work();
                if (ray_work.needed == 0) ray_work.entered = 0;
                sum.add(ray_work);
            };
            for (const auto& [key, work] : seen)
                end(instances[key], work, hit.hit != 0 && ranges[key].contains(hit.path));
            for (const auto& [object, work] : seen_meshes)
                end(meshes[object], work, hit.hit != 0 && hit.object == object);
            for (const auto& [material, work] : seen_materials) materials[material].add(work);
        }

        const auto blame = watch(*scene, rays, "alpha_mask", level);
        CHECK(blame->rows(BlameTable::instances).size() == instances.size());
        std::uint64_t wasted = 0;
        for (const auto& [key, work] : blame->rows(BlameTable::instances)) {
            const BlamedWork& expected = instances[{key.placements.first, key.depth}];
            CHECK(work.boxes == expected.boxes);
            CHECK(work.prims == expected.prims);
            CHECK(work.rays == expected.rays);
            CHECK(work.hit_rays == expected.hit_rays);
            CHECK(work.wasted == expected.wasted);
            wasted += work.wasted;
        }
        CHECK(wasted != 0);
        CHECK(blame->rows(BlameTable::meshes).size() == meshes.size());
        for (const auto& [key, work] : blame->rows(BlameTable::meshes)) {
            const BlamedWork& expected = meshes[key.index];
            CHECK(work.work() == expected.work());
            CHECK(work.hit_rays == expected.hit_rays);
            CHECK(work.wasted == expected.wasted);
            CHECK(work.entered == expected.entered);
            CHECK(work.needed == expected.needed);
        }
        std::uint64_t refused = 0;
        for (const auto& [key, work] : blame->rows(BlameTable::materials)) {
            // Lanes that were judged, of which some lost to another lane of their block.
            CHECK(work.candidates >= materials[key.index].candidates);
            CHECK(work.refused == materials[key.index].refused);
            refused += work.refused;
        }
        CHECK(refused != 0);
    }
}

TEST_CASE("an instance is named by as many steps as it is deep") {
    const auto scene = test::build_scene(test::tree_scene());
    CHECK(instance_path(*scene, {3, 3}, 1) == "second");
    CHECK(instance_path(*scene, {4, 1}, 1) == "second");
    CHECK(instance_path(*scene, {4, 1}, 2) == "second/low");
    CHECK(instance_path(*scene, {4, 0}, 1).empty());
}

TEST_CASE("more rows than may be kept are told") {
    const auto scene = test::build_scene(conformance::nested_scene(3, 2));
    conformance::Random random(4);
    std::vector<Ray> rays = conformance::random_rays(100, 6, random);
    CHECK_FALSE(watch(*scene, rays, "opaque")->overflowed());
    CHECK(watch(*scene, rays, "opaque", innermost_level, 1000, 3)->overflowed());
}

TEST_CASE("finding: instances that overlap") {
    std::vector<ObjectDescription> parts;
    std::vector<Vec3> all;
    for (std::uint64_t i = 0; i < 12; ++i) {
        const auto corners = speckles(200, i);
        parts.push_back(mesh("part", corners));
        all.insert(all.end(), corners.begin(), corners.end());
    }
    const Seen apart = look(placed(parts));
    CHECK(apart.has("overlapping_instances"));
    // Split by where they lie, they are no more within each other.
    std::vector<std::vector<Vec3>> columns(12);
    for (std::size_t i = 0; i < all.size(); i += 3) {
        const auto column = static_cast<std::size_t>(std::clamp((all[i].x + 1) * 6, 0.0F, 11.0F));
        columns[column].insert(columns[column].end(), &all[i], &all[i] + 3);
    }
    std::vector<ObjectDescription> beside;
    for (const auto& corners : columns) beside.push_back(mesh("column", corners));
    CHECK_FALSE(look(placed(beside)).has("overlapping_instances"));
    const Seen joined = look(placed({mesh("joined", all)}));
    CHECK_FALSE(joined.has("overlapping_instances"));
    CHECK(joined.work < apart.work / 2);
}

TEST_CASE("finding: long thin triangles") {
    const Seen whole = look(placed({mesh("needles", needles(1))}));
    CHECK(whole.has("thin_triangles"));
    const Seen cut = look(placed({mesh("cut", needles(128))}));
    CHECK_FALSE(cut.has("thin_triangles"));
    CHECK(cut.work < whole.work / 2);
}

TEST_CASE("findings are of what much work is spent in") {
    std::vector<Vec3> small = needles(1);
    for (Vec3& corner : small) corner *= 0.08F;
    CHECK_FALSE(look(placed({mesh("few rays", small), mesh("much", speckles(3000, 7))}))
                    .has("thin_triangles"));
    CHECK(look(placed({mesh("all rays", small)})).has("thin_triangles"));
}

TEST_CASE("finding: crowded leaves") {
    const std::vector<Vec3> once = speckles(100, 7);
    std::vector<Vec3> often;
    for (std::size_t i = 0; i < once.size(); i += 3) {
        for (int copy = 0; copy < 40; ++copy)
            often.insert(often.end(), once.begin() + static_cast<std::ptrdiff_t>(i),
                         once.begin() + static_cast<std::ptrdiff_t>(i + 3));
    }
    const Seen crowded = look(placed({mesh("copies", often)}));
    CHECK(crowded.has("crowded_leaves"));
    const Seen plain = look(placed({mesh("plain", once)}));
    CHECK_FALSE(plain.has("crowded_leaves"));
    CHECK(plain.work < crowded.work / 2);
    // A few places with many copies are found among many places; whatever the order of corners is.
    std::vector<Vec3> mixed = speckles(3000, 9);
    for (int copy = 0; copy < 600; ++copy)
        for (std::size_t corner = 0; corner < 3; ++corner)
            mixed.push_back(once[(corner + static_cast<std::size_t>(copy)) % 3]);
    CHECK(look(placed({mesh("mixed", mixed)})).has("crowded_leaves"));
}

TEST_CASE("leaves that are crowded without copies are not blamed on copies") {
    // Sheets so close together that a ray tests most of them.
    std::vector<Vec3> sheets;
    for (int i = 0; i < 200; ++i) {
        const float z = 1e-4F * static_cast<float>(i);
        for (const Vec3& corner : {Vec3(-1, -1, z), Vec3(1, -1, z + 0.9F), Vec3(0, 1, z - 0.9F)})
            sheets.push_back(corner);
    }
    const Seen seen = look(placed({mesh("sheets", sheets)}));
    CHECK_FALSE(seen.has("crowded_leaves"));
    // Points and lines in one place are no triangles that a ray could hit.
    std::vector<Vec3> points = speckles(20, 3);
    points.resize(points.size() + 3000, Vec3(0.5F));
    CHECK_FALSE(look(placed({mesh("points", points)})).has("crowded_leaves"));
}

TEST_CASE("finding: levels that hold one child") {
    SceneDescription direct =
        placed({mesh("speckles", speckles(300, 7)), mesh("b", speckles(9, 1))});
    SceneDescription nested = direct;
    // The root's first instance is wrapped twice: objects 3 and 4 hold one child each.
    for (const std::uint32_t child : {0U, 3U}) {
        ObjectDescription wrapper;
        wrapper.name = "wrapper";
        wrapper.instances = {test::place(child, Transform{}, "inner")};
        nested.objects.push_back(wrapper);
    }
    nested.objects[2].instances[0].object = 4;
    const Seen wrapped = look(nested);
    CHECK(wrapped.has("single_child_levels"));
    const Seen unwrapped = look(direct);
    CHECK_FALSE(unwrapped.has("single_child_levels"));
    // Such a level costs no box, but an entry and its transform.
    CHECK(unwrapped.instances < wrapped.instances);
    CHECK(unwrapped.work <= wrapped.work);
}

TEST_CASE("finding: cut-outs that refuse most of their candidates") {
    // Layers of squares whose texture is opaque in its lower left quarter of a quarter.
    const auto layers = [](float size) {
        SceneDescription scene;
        ImageDescription image{16, 16, std::vector<std::uint8_t>(16 * 16 * 4, 255)};
        for (std::size_t y = 0; y < 16; ++y)
            for (std::size_t x = 0; x < 16; ++x)
                image.rgba[4 * (16 * y + x) + 3] = x < 4 && y < 4 ? 255 : 0;
        scene.images.push_back(image);
        TextureDescription texture;
        texture.image = 0;
        texture.nearest = true;
        scene.textures.push_back(texture);
        MaterialDescription material;
        material.name = "lace";
        material.texture = 0;
        material.alpha_mode = AlphaMode::mask;
        scene.materials.push_back(material);
        ObjectDescription object;
        object.name = "layers";
        for (int i = 0; i < 10; ++i) {
            GeometryDescription square = test::unit_square(0);
            for (Vec3& p : square.positions)
                p = Vec3(-1 + 2 * size * p.x, -1 + 2 * size * p.y, 0.1F * static_cast<float>(i));
            for (Vec2& st : square.texcoords[0]) st *= size;
            object.geometries.push_back(square);
        }
        scene.objects = {object};
        scene.root = 0;
        return scene;
    };
    const Seen wide = look(layers(1), "alpha_mask");
    CHECK(wide.has("refusing_cutouts"));
    const Seen cut = look(layers(0.25F), "alpha_mask");
    CHECK_FALSE(cut.has("refusing_cutouts"));
    CHECK(cut.work < wide.work / 2);
}
