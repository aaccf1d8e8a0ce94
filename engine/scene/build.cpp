// Description -> snapshot: one tree per object, children first, then one arena.
#include "engine/scene/checks/description_check.h"
#include "engine/scene/content.h"
#include "engine/scene/graph.h"
#include "engine/scene/opacity.h"
#include "engine/scene/path_table.h"
#include "engine/scene/placed_box.h"
#include "engine/scene/precision.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <iterator>
#include <limits>
#include <utility>

namespace raynest {
namespace {

/// Adds the seconds of a scope to a sum.
class Stopwatch {
public:
    explicit Stopwatch(double& sum) : sum_(sum) {}
    Stopwatch(const Stopwatch&) = delete;
    ~Stopwatch() {
        sum_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
    }

private:
    double& sum_;
    const std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

class ArenaBuilder {
public:
    ArenaBuilder(const SceneDescription& description, const Graph& graph)
        : description_(description),
          graph_(graph),
          opacity_(description) {}

    Result<Arena> build() {
        content_.build = description_.build;
        add_surfaces(description_, content_);
        add_cameras(description_, content_);
        add_lights(description_, content_);
        content_.motion = description_.motion;
        content_.up = description_.up;
        for (const GraphObject& object : graph_.objects) {
            if (auto added = add_object(object); !added) return tl::unexpected(added.error());
        }
        add_path_nodes(description_, graph_, content_);
        auto& numbers = content_.instance_numbers;
        if (std::all_of(numbers.begin(), numbers.end(), [](auto n) { return n == no_id; }))
            numbers.clear();
        // Turn -0 into 0: equal scenes must have equal bytes.
        for (std::size_t i = 0; i < 3; ++i) content_.origin[i] = description_.origin[i] + 0.0;
        content_.degenerate_triangles = degenerate_triangles_;
        for (const auto& [reason, count] : graph_.skipped) {
            content_.skips.push_back({count, content_.names.add(reason), 0});
        }
        for (const std::string& warning : description_.warnings) {
            content_.warnings.push_back(content_.names.add(warning));
        }
        {
            const Stopwatch stopwatch(build_seconds_);
            content_.bounds = scene_bounds(content_);
        }
        warn(rounding_warning(description_, content_.bounds));
        if (const auto lost = graph_.skipped.find("singular_instances");
            lost != graph_.skipped.end() && !graph_.singular.empty()) {
            const bool one = lost->second == 1;
            warn(std::to_string(lost->second) +
                 (one ? " placement is left out, that of "
                      : " placements are left out, first that of ") +
                 graph_.singular +
                 ": a scale of 0, of it or above it, leaves no way to bring rays "
                 "into its space. If it should be seen flat, apply the scale to "
                 "its mesh");
        }
        if (degenerate_triangles_ > triangles_ / 2) {
            warn(std::to_string(degenerate_triangles_) + " of " + std::to_string(triangles_) +
                 (degenerate_triangles_ == 1 ? " triangles has" : " triangles have") +
                 " no area, which nothing can hit: most of the scene is missing. "
                 "Check its units, and whether corners were merged");
        }
        add_variants();
        if (content_.skips.size() > scene_skips_max) {
            return fail(ErrorCode::limit_exceeded, "the scene has more reasons for skips than " +
                                                       std::to_string(scene_skips_max));
        }
        if (content_.names.bytes().size() >= no_id) {
            return fail(ErrorCode::limit_exceeded, "the scene's names take more than 4 GiB");
        }
        Arena arena = write_arena(content_);
        const Stopwatch stopwatch(build_seconds_);
        write_trees(content_, arena);
        return arena;
    }

    /// Seconds spent on bounds, trees and leaf blocks: the part that other libraries call a build.
    [[nodiscard]] double build_seconds() const { return build_seconds_; }

private:
    /// Puts a warning before the others: it is about the whole scene. Nothing for "".
    void warn(const std::string& text) {
        if (text.empty()) return;
        if (content_.warnings.size() == scene_warnings_max) content_.warnings.pop_back();
        content_.warnings.push_back(content_.names.add(text));
        std::ranges::rotate(content_.warnings, std::prev(content_.warnings.end()));
    }

    /// Puts the names of variants behind the warnings, as many as there is room for.
    void add_variants() {
        const std::size_t room = scene_warnings_max - content_.warnings.size();
        const std::size_t count = std::min(description_.variants.size(), room);
        for (std::size_t i = 0; i < count; ++i)
            content_.warnings.push_back(content_.names.add(description_.variants[i]));
        content_.variants = static_cast<std::uint16_t>(count);
        constexpr std::size_t most = std::numeric_limits<std::uint8_t>::max();
        if (const std::size_t chosen = description_.chosen_variant; chosen <= std::min(count, most))
            content_.chosen_variant = static_cast<std::uint8_t>(chosen);
    }

    Result<void> add_object(const GraphObject& node) {
        const ObjectDescription& source = description_.objects[node.source];
        const std::string label = object_label(description_, node.source);
        ObjectRecord object{};
        object.name = content_.names.add(source.name);
        object.placement_count = node.traced.placement_count;
        object.levels = node.levels;
        object.origin_error = 1;
        add_geometries(source, object);
        add_records(source, object);

        auto built = build_object(node, object, label);
        if (!built) return tl::unexpected(built.error());
        Tree& tree = *built;
        const std::size_t blocks = tree.block_lanes.size() / 8;
        if (blocks > std::size_t{leaf_first_max} + 1 || tree.height > tree_height_max) {
            return fail(ErrorCode::limit_exceeded,
                        "object " + label + " is too large for one tree: split it into several");
        }
        object.bounds = tree.bounds;
        object.root = tree.root;
        object.first_node = node_count_;
        object.first_block = block_count_;
        object.node_count = static_cast<std::uint32_t>(tree.nodes.size());
        object.block_count = static_cast<std::uint32_t>(blocks);
        object.texcoord_blocks = content_.attributes.reserve(
            has_alpha_texture(object) ? blocks * sizeof(TexcoordBlock) : 0);
        node_count_ += object.node_count;
        block_count_ += object.block_count;

        content_.sources.push_back(&source);
        content_.trees.push_back(std::move(tree));
        content_.objects.push_back(object);
        return {};
    }

    Result<Tree> build_object(const GraphObject& node, ObjectRecord& object,
                              const std::string& label) {
        const Stopwatch stopwatch(build_seconds_);
        const ObjectDescription& source = description_.objects[node.source];
        std::vector<Box> boxes = source.record_bounds;
        for (const GeometryDescription& geometry : source.geometries) {
            degenerate_triangles_ += count_degenerate(geometry);
        }
        triangles_ += own_triangles(source);
        add_instances(node, object, boxes);
        const auto is_far = [](const Box& box) { return !in_range(box); };
        if (const auto far = std::ranges::count_if(boxes, is_far); far != 0) {
            // Vertices are checked before: what lies too far out are records, then instances.
            const auto first =
                static_cast<std::size_t>(std::ranges::find_if(boxes, is_far) - boxes.begin());
            const std::size_t own = boxes.size() - node.instances.size();
            const std::string where = first < own ? "object " + label
                                                  : instance_label(description_, node.source,
                                                                   node.declared_as[first - own]);
            return fail(ErrorCode::scene_invalid,
                        where +
                            (far == 1 ? " reaches"
                                      : " and " + std::to_string(far - 1) +
                                            (far == 2 ? " other reach" : " others reach")) +
                            " beyond 1e15; check scales and positions, of nodes above it, too");
        }

        const bool clips = description_.build == BuildQuality::high;
        const PageVector<Corners> corners =
            clips ? triangle_corners(source) : PageVector<Corners>();
        return build_tree({boxes, object.triangle_count, object.record_count, object.instance_count,
                           description_.build, corners, triangle_boxes(source)});
    }

    void add_geometries(const ObjectDescription& source, ObjectRecord& object) {
        object.first_geometry = static_cast<std::uint32_t>(content_.geometries.size());
        object.geometry_count = static_cast<std::uint32_t>(source.geometries.size());
        for (const GeometryDescription& geometry : source.geometries) {
            GeometryRecord record{};
            record.positions = content_.attributes.add(geometry.positions);
            record.indices = content_.attributes.add(geometry.indices);
            record.texcoords[0] = content_.attributes.add(geometry.texcoords[0]);
            record.texcoords[1] = content_.attributes.add(geometry.texcoords[1]);
            record.colours = content_.attributes.add(geometry.colours);
            record.opacity =
                content_.attributes.add(content_.opacities.emplace_back(opacity_.build(geometry)));
            record.first_triangle = object.triangle_count;
            record.triangle_count = static_cast<std::uint32_t>(geometry.indices.size() / 3);
            record.vertex_count = static_cast<std::uint32_t>(geometry.positions.size());
            record.material = geometry.material;
            content_.geometry_shading.push_back({content_.attributes.add(geometry.normals),
                                                 content_.attributes.add(geometry.tangents)});
            object.triangle_count += record.triangle_count;
            content_.geometries.push_back(record);
        }
    }

    /// Adds the colours of records as those of a geometry without triangles (record_colours.h).
    void add_record_colours(const ObjectDescription& source, ObjectRecord& object) {
        GeometryRecord record{};
        record.positions = record.indices = record.opacity = no_offset;
        record.texcoords[0] = record.texcoords[1] = no_offset;
        record.colours = content_.attributes.add(source.record_colours);
        record.vertex_count = object.record_count;
        record.material = no_id;
        content_.geometry_shading.push_back({no_offset, no_offset});
        object.first_geometry = static_cast<std::uint32_t>(content_.geometries.size());
        object.geometry_count = 1;
        content_.geometries.push_back(record);
    }

    void add_records(const ObjectDescription& source, ObjectRecord& object) {
        object.first_record = record_bytes_;
        if (source.record_bounds.empty()) return;
        object.record_type = primitive_type(source.record_type.c_str());
        object.record_count = static_cast<std::uint32_t>(source.record_bounds.size());
        object.record_size =
            static_cast<std::uint32_t>(source.records.size() / object.record_count);
        record_bytes_ += records_bytes(object);
        if (!source.record_colours.empty()) add_record_colours(source, object);
        const std::uint32_t name = content_.names.add(source.record_type);
        auto& types = content_.record_types;
        if (std::find(types.begin(), types.end(), name) == types.end()) types.push_back(name);
    }

    [[nodiscard]] bool has_alpha_texture(const ObjectRecord& object) const {
        const GeometryRecord* const first = content_.geometries.data() + object.first_geometry;
        return std::any_of(first, first + object.geometry_count, [&](const GeometryRecord& record) {
            return raynest::has_alpha_texture(record, content_.materials.data());
        });
    }

    void add_instances(const GraphObject& node, ObjectRecord& object, std::vector<Box>& boxes) {
        const ObjectDescription& source = description_.objects[node.source];
        object.first_instance = static_cast<std::uint32_t>(content_.instances.size());
        object.instance_count = static_cast<std::uint32_t>(node.instances.size());
        const std::size_t first = boxes.size();
        boxes.resize(first + node.instances.size());
        std::vector<float> errors(node.instances.size());
        std::vector<double> paddings(node.instances.size());
        tbb::parallel_for(std::size_t{0}, node.instances.size(), [&](std::size_t i) {
            const Transform& to_parent = source.instances[node.declared_as[i]].transform;
            const std::uint32_t child = node.instances[i].object;
            errors[i] = placement_error(to_parent, content_.objects[child].origin_error);
            const PlacedBox placed = placed_box(content_, child, to_parent, errors[i]);
            boxes[first + i] = placed.box;
            paddings[i] = placed.padding;
        });
        for (std::size_t i = 0; i < node.instances.size(); ++i) {
            const InstanceDescription& declared = source.instances[node.declared_as[i]];
            object.origin_error = std::max(object.origin_error, errors[i]);
            content_.instance_paddings.push_back(paddings[i]);
            content_.instances.push_back(node.instances[i]);
            content_.instance_infos.push_back({declared.transform, declared.uid, 0, declared.mask});
        }
        if (description_.path_nodes.empty()) name_instances(node);
    }

    /// Names the instances that were added last by their own names or those of their objects.
    /// Singular instances, which are left out, have numbers too.
    void name_instances(const GraphObject& node) {
        std::vector<std::uint32_t> names;
        for (const InstanceDescription& declared : description_.objects[node.source].instances)
            names.push_back(content_.names.add(step_name(description_, declared)));
        const std::vector<std::uint32_t> numbers = number_siblings(names);
        const std::size_t first = content_.instance_infos.size() - node.declared_as.size();
        for (std::size_t i = 0; i < node.declared_as.size(); ++i) {
            content_.instance_infos[first + i].name = names[node.declared_as[i]];
            content_.instance_numbers.push_back(numbers[node.declared_as[i]]);
        }
    }

    const SceneDescription& description_;
    const Graph& graph_;
    OpacityBuilder opacity_;
    Content content_;
    std::uint64_t node_count_ = 0;
    std::uint64_t block_count_ = 0;
    std::uint64_t record_bytes_ = 0;
    std::uint64_t degenerate_triangles_ = 0;
    std::uint64_t triangles_ = 0;
    double build_seconds_ = 0;
};

/// Checks, before anything is built, that section counts fit the view's u32, and that nodes name
/// every placement.
Result<void> check_counts(const SceneDescription& description, const Graph& graph) {
    std::uint64_t instances = 0;
    std::uint64_t geometries = 0;
    for (const GraphObject& object : graph.objects) {
        instances += object.instances.size();
        geometries += description.objects[object.source].geometries.size();
    }
    if (instances >= no_id || geometries >= no_id) {
        return fail(ErrorCode::limit_exceeded,
                    "the scene has more than 2^32 instances or geometries: nest them in groups");
    }
    std::uint64_t named = 0;
    for (const PathNodeDescription& node : description.path_nodes) named += node.placements;
    if (!description.path_nodes.empty() && named != graph.declared_leaves)
        return fail(ErrorCode::scene_invalid, "the path nodes do not name every placement");
    return {};
}

}  // namespace

Result<BuiltArena> build_arena(const SceneDescription& description) {
    if (auto checked = check_description(description); !checked) {
        return tl::unexpected(checked.error());
    }
    const auto graph = resolve_graph(description);
    if (!graph) return tl::unexpected(graph.error());
    if (auto counted = check_counts(description, *graph); !counted) {
        return tl::unexpected(counted.error());
    }
    ArenaBuilder builder(description, *graph);
    auto arena = builder.build();
    if (!arena) return tl::unexpected(arena.error());
    return BuiltArena{std::move(*arena), builder.build_seconds()};
}

Result<std::shared_ptr<const Snapshot>> Snapshot::build(const SceneDescription& description) {
    return build_arena(description).and_then(open);
}

}  // namespace raynest
