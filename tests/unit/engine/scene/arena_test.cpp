// Tests arenas from outside: a round trip, and thousands of damaged ones.
#include "engine/bvh/node.h"
#include "engine/geometry/path.h"
#include "engine/geometry/triangle.h"
#include "engine/intersectors/texture.h"
#include "engine/scene/format.h"
#include "engine/shading/texture_lookup.h"
#include "tests/unit/engine/rich_scene.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <random>
#include <vector>

using namespace raynest;

namespace {

Arena copy_of(std::span<const std::byte> bytes) {
    Arena arena(bytes.size());
    std::copy(bytes.begin(), bytes.end(), arena.data());
    return arena;
}

/// Reads everything that traversal and columns may reach; false if it reads out of bounds. Every
/// walk must end, so a cycle would show as a time-out.
class Walk {
public:
    explicit Walk(const Snapshot& scene) : scene_(scene), view_(scene.view()) {}

    bool is_sound() {
        bool sound = true;
        for (std::uint32_t i = 0; i < view_.object_count; ++i)
            sound = sound && tree(view_.objects[i]);
        for (std::uint64_t path = 0; path < std::min<std::uint64_t>(placement_count(), 64);
             ++path) {
            sound = sound && reads_path(path) && reads_path(placement_count() - 1 - path);
        }
        return sound && surfaces();
    }

private:
    [[nodiscard]] bool inside(const void* first, std::size_t bytes) const {
        const auto* at = static_cast<const std::byte*>(first);
        const std::byte* begin = scene_.bytes().data();
        return at >= begin && bytes <= scene_.bytes().size() &&
               at + bytes <= begin + scene_.bytes().size();
    }

    [[nodiscard]] std::uint64_t placement_count() const {
        return view_.objects[view_.root].placement_count;
    }

    bool tree(const ObjectRecord& object) const {
        if (object.root == child_empty) return true;
        std::vector<std::uint32_t> stack{object.root};
        std::uint64_t visited = 0;
        while (!stack.empty()) {
            const std::uint32_t child = stack.back();
            stack.pop_back();
            if (++visited > 100'000) return false;
            if (is_leaf(child)) {
                if (!leaf(object, child)) return false;
                continue;
            }
            const Node* node = view_.nodes + object.first_node + child;
            if (!inside(node, sizeof *node)) return false;
            for (std::uint32_t slot = 0; slot < 8; ++slot) {
                if ((node->valid() >> slot & 1U) != 0) stack.push_back(node->child[slot]);
            }
        }
        return true;
    }

    bool leaf(const ObjectRecord& object, std::uint32_t child) const {
        switch (kind_of(child)) {
            case ChildKind::triangles:
                for (std::uint32_t i = 0; i < leaf_count(child); ++i) {
                    const auto* block = view_.blocks + object.first_block + leaf_first(child) + i;
                    if (!inside(block, sizeof *block)) return false;
                    for (int lane = 0; lane < 8; ++lane) {
                        if (block->triangle[lane] == no_id) continue;
                        if (!surface(object, block->triangle[lane])) return false;
                        if (!texcoords(object, *block, lane)) return false;
                    }
                }
                return true;
            case ChildKind::records:
                for (std::uint32_t i = 0; i < object.record_count; ++i) {
                    if (!inside(view_.record_of(object, i), object.record_size)) return false;
                }
                return leaf_first(child) + leaf_count(child) <= object.record_count;
            case ChildKind::instance: {
                const auto* instance =
                    view_.instances + object.first_instance + leaf_instance(child);
                return inside(instance, sizeof *instance) && instance->object < view_.object_count;
            }
        }
        return false;
    }

    bool surface(const ObjectRecord& object, std::uint32_t triangle) const {
        const GeometryRecord& geometry = view_.geometry_of(object, triangle);
        if (!inside(&geometry, sizeof geometry)) return false;
        const auto* corner = view_.attribute<std::uint32_t>(geometry.indices) +
                             std::size_t{3} * (triangle - geometry.first_triangle);
        if (!inside(corner, 12)) return false;
        for (int i = 0; i < 3; ++i) {
            if (!inside(view_.attribute<Vec3>(geometry.positions) + corner[i], 12)) return false;
            for (const std::uint64_t set : geometry.texcoords) {
                if (set != no_offset && !inside(view_.attribute<Vec2>(set) + corner[i], 8)) {
                    return false;
                }
            }
            if (geometry.colours != no_offset &&
                !inside(view_.attribute<std::uint32_t>(geometry.colours) + corner[i], 4)) {
                return false;
            }
        }
        const ShadingView& shading = scene_.shading();
        const GeometryShading& more = shading.geometries[&geometry - view_.geometries];
        for (int i = 0; i < 3; ++i) {
            if (more.normals != no_offset &&
                !inside(view_.attribute<Vec3>(more.normals) + corner[i], 12))
                return false;
            if (more.tangents != no_offset &&
                !inside(view_.attribute<Vec4>(more.tangents) + corner[i], 16))
                return false;
        }
        return geometry.material == no_id ||
               (geometry.material < view_.material_count &&
                inside(shading.surfaces + geometry.material, sizeof(SurfaceRecord)));
    }

    bool texcoords(const ObjectRecord& object, const TriangleBlock& block, int lane) const {
        const GeometryRecord& geometry = view_.geometry_of(object, block.triangle[lane]);
        return !has_alpha_texture(geometry, view_.materials) ||
               inside(corner_texcoords(view_, object, block, lane), 3 * sizeof(Vec2));
    }

    bool surfaces() const {
        for (std::uint32_t i = 0; i < view_.texture_count; ++i) {
            const TextureRecord& t = view_.textures[i];
            const std::size_t pixels = std::size_t{t.width} * t.height;
            if (!inside(view_.attribute<std::byte>(t.colour), 4 * pixels) ||
                (t.alpha != no_offset && !inside(view_.attribute<std::byte>(t.alpha), pixels))) {
                return false;
            }
            for (std::uint32_t level = 1; level < scene_.shading().levels[i].count; ++level) {
                const TexturePlane plane = texture_plane(scene_.shading(), i, level);
                if (!inside(plane.rgba, std::size_t{4} * plane.width * plane.height)) return false;
            }
        }
        const auto named = [&](std::uint32_t texture) {
            return texture == no_id || texture < view_.texture_count;
        };
        for (std::uint32_t i = 0; i < view_.material_count; ++i) {
            const SurfaceRecord& s = scene_.shading().surfaces[i];
            if (view_.materials[i].texture != no_id &&
                view_.textures[view_.materials[i].texture].alpha == no_offset)
                return false;
            for (const TextureUse& use : s.textures)
                if (!named(use.texture)) return false;
        }
        return inside(scene_.shading().lights, scene_.shading().light_count * sizeof(LightRecord));
    }

    bool reads_path(std::uint64_t path) const {
        const auto steps = expand_path(scene_, path);
        return steps && steps->size() < scene_depth_max;
    }

    const Snapshot& scene_;
    const SceneView& view_;
};

}  // namespace

TEST_CASE("an arena opened from its bytes is the same scene") {
    const auto built = test::rich_scene();
    const auto opened = Snapshot::open({copy_of(built->bytes())});
    REQUIRE(opened.has_value());
    CHECK((*opened)->digest() == built->digest());
    CHECK((*opened)->statistics().instances == built->statistics().instances);
    CHECK((*opened)->statistics().warnings == built->statistics().warnings);
    CHECK((*opened)->statistics().skipped == built->statistics().skipped);
    CHECK((*opened)->record_types() == built->record_types());
    CHECK((*opened)->view().masked_materials == 1);
    CHECK(Walk(**opened).is_sound());
}

TEST_CASE("an arena cut short or grown is refused") {
    const auto built = test::rich_scene();
    const std::span<const std::byte> bytes = built->bytes();
    for (std::size_t cut = 0; cut < bytes.size(); cut += 61) {
        CHECK_FALSE(Snapshot::open({copy_of(bytes.first(cut))}).has_value());
    }
    std::vector<std::byte> grown(bytes.begin(), bytes.end());
    grown.resize(grown.size() + 64);
    CHECK_FALSE(Snapshot::open({copy_of(grown)}).has_value());
}

TEST_CASE("an arena of another version is an error with a remedy") {
    const auto built = test::rich_scene();
    Arena arena = copy_of(built->bytes());
    arena.data()[offsetof(format::Header, version)] = std::byte{format::version + 1};
    const auto opened = Snapshot::open({std::move(arena)});
    REQUIRE_FALSE(opened.has_value());
    CHECK(opened.error().code == ErrorCode::scene_unsupported);
    CHECK(opened.error().message.find("import the scene again") != std::string::npos);
}

TEST_CASE("the axis that points up and the variants come back, and are checked") {
    SceneDescription description = test::tree_scene();
    description.up = UpAxis::z;
    description.warnings = {"dusty"};
    description.variants = {"beach", "night"};
    description.chosen_variant = 2;
    const auto built = test::build_scene(description);
    CHECK(built->up() == UpAxis::z);
    CHECK(built->statistics().warnings == std::vector<std::string>{"dusty"});
    CHECK(built->statistics().variants == std::vector<std::string>{"beach", "night"});
    CHECK(built->statistics().chosen_variant == "night");
    const auto opens = [&](const auto& change) {
        Arena arena = copy_of(built->bytes());
        change(*reinterpret_cast<format::Header*>(arena.data()));
        return Snapshot::open({std::move(arena)}).has_value();
    };
    CHECK(opens([](format::Header&) {}));
    CHECK_FALSE(opens([](format::Header& header) { header.up = static_cast<UpAxis>(2); }));
    CHECK_FALSE(opens([](format::Header& header) { header.variants = 4; }));
    CHECK_FALSE(opens([](format::Header& header) { header.chosen_variant = 3; }));
}

TEST_CASE("data copied out of an arena is bounded, whoever wrote it") {
    SceneDescription scene = test::tree_scene();
    scene.warnings.assign(scene_warnings_max, std::string(scene_name_bytes_max, 'w'));
    const auto good = test::build_scene(scene);
    CHECK(good->statistics().warnings.size() == scene_warnings_max);

    scene.warnings.emplace_back("one more");
    CHECK(Snapshot::build(scene).error().code == ErrorCode::limit_exceeded);
    scene.warnings = {std::string(scene_name_bytes_max + 1, 'w')};
    CHECK(Snapshot::build(scene).error().code == ErrorCode::limit_exceeded);
    scene.warnings.clear();
    scene.cameras.resize(scene_cameras_max + 1);
    CHECK(Snapshot::build(scene).error().code == ErrorCode::limit_exceeded);

    // Two names become one that is too long.
    scene.cameras.clear();
    scene.warnings = {std::string(scene_name_bytes_max, 'v'), std::string(9, 'w')};
    Arena joined = copy_of(test::build_scene(scene)->bytes());
    auto* const names =
        const_cast<char*>(format::section<char>(joined.data(), format::Section::names));
    const std::string_view all(names, format::section_size(joined.data(), format::Section::names));
    const std::size_t end = all.find(std::string(scene_name_bytes_max, 'v')) + scene_name_bytes_max;
    names[end] = 'x';
    const auto refused = Snapshot::open({std::move(joined)});
    REQUIRE_FALSE(refused.has_value());
    CHECK(refused.error().message.find("name") != std::string::npos);
}

TEST_CASE("invalid trees are refused") {
    const auto built = test::rich_scene();
    const SceneView& view = built->view();
    const ObjectRecord* const object = view.objects;
    REQUIRE(object->node_count > 1);
    const Node* const root = view.nodes + object->first_node;
    const auto opens_with = [&](auto&& spoil, const Node* node = nullptr) {
        Arena arena = copy_of(built->bytes());
        const auto offset = reinterpret_cast<const std::byte*>(node == nullptr ? root : node) -
                            built->bytes().data();
        spoil(*reinterpret_cast<Node*>(arena.data() + offset));
        return Snapshot::open({std::move(arena)}).has_value();
    };
    CHECK(opens_with([](Node&) {}));
    CHECK_FALSE(opens_with([](Node& n) { n.child[0] = 0; }));            // a cycle
    CHECK_FALSE(opens_with([](Node& n) { n.child[0] = n.child[1]; }));   // named twice
    CHECK_FALSE(opens_with([](Node& n) { n.child[0] = child_empty; }));  // against the mask
    CHECK_FALSE(opens_with([](Node& n) { n.child[0] = 0x70000000; }));   // far away
    CHECK_FALSE(opens_with([](Node& n) { n.order[3] = n.order[2]; }));   // no permutation
    CHECK_FALSE(opens_with([](Node& n) { n.child[0] = make_instance_leaf(0); }));

    // Traversals take the first of an order for the children that are there.
    const Node* const end = root + object->node_count;
    const auto has_room = [](const Node& n) { return n.valid() >= 3 && n.valid() < 0xFF; };
    const Node* const part = std::find_if(root, end, has_room);
    REQUIRE(part != end);
    const auto first_empty = static_cast<std::uint32_t>(std::popcount(part->valid()));
    const auto exchange_slots = [](Node& n, std::uint32_t a, std::uint32_t b) {
        for (std::uint32_t& word : n.order) {
            for (std::uint32_t octant = 0; octant < 8; ++octant) {
                const std::uint32_t slot = word >> (3 * octant) & 7U;
                if (slot == a || slot == b) word ^= (a ^ b) << (3 * octant);
            }
        }
    };
    CHECK(opens_with([&](Node& n) { exchange_slots(n, 0, 1); }, part));
    CHECK_FALSE(opens_with([&](Node& n) { exchange_slots(n, 0, first_empty); }, part));
    const auto leave_a_gap = [&](Node& n) {
        exchange_slots(n, 0, first_empty);
        std::swap(n.child[0], n.child[first_empty]);
        n.order[0] ^= (1U | 1U << first_empty) << 24;
    };
    CHECK_FALSE(opens_with(leave_a_gap, part));
}

TEST_CASE("a damaged arena is refused, or every walk over it stays in range") {
    const auto built = test::rich_scene();
    const std::span<const std::byte> bytes = built->bytes();
    std::mt19937_64 random(20);
    constexpr std::uint32_t words[] = {0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x7F800000};
    int refused = 0;
    int survived = 0;
    for (int round = 0; round < 6000; ++round) {
        Arena arena = copy_of(bytes);
        for (std::uint64_t change = random() % 3 + 1; change > 0; --change) {
            if (random() % 2 == 0) {
                arena.data()[random() % bytes.size()] ^= static_cast<std::byte>(1U << random() % 8);
            } else {
                const std::uint32_t word = words[random() % std::size(words)];
                std::memcpy(arena.data() + random() % (bytes.size() / 4) * 4, &word, 4);
            }
        }
        const auto opened = Snapshot::open({std::move(arena)});
        if (!opened) {
            ++refused;
            REQUIRE(opened.error().code != ErrorCode::internal);
            continue;
        }
        ++survived;
        REQUIRE(Walk(**opened).is_sound());
    }
    MESSAGE("damaged arenas: " << refused << " refused, " << survived << " harmless");
    CHECK(refused > 1000);
    CHECK(survived > 100);
}

TEST_CASE("every word of the records is checked or harmless") {
    const auto built = test::rich_scene();
    const std::span<const std::byte> bytes = built->bytes();
    const auto* header = reinterpret_cast<const format::Header*>(bytes.data());
    const auto& attributes =
        header->sections[static_cast<std::size_t>(format::Section::attributes)];
    for (const std::uint32_t word : {0xFFFFFFFFU, 0x00FFFFFFU, 0U}) {
        for (std::size_t at = 0; at + 4 <= bytes.size(); at += 4) {
            if (at >= attributes.offset && at < attributes.offset + attributes.count) continue;
            Arena arena = copy_of(bytes);
            std::memcpy(arena.data() + at, &word, 4);
            const auto opened = Snapshot::open({std::move(arena)});
            if (opened) REQUIRE(Walk(**opened).is_sound());
        }
    }
}
