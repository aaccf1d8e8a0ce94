#include "engine/scene/edits/rebuild.h"

#include "engine/scene/content.h"
#include "engine/scene/edits/view_trees.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstring>
#include <map>
#include <utility>

namespace raynest {
namespace {

using format::Section;

/// An object with a new tree.
struct Rebuilt {
    ObjectRecord record;
    ObjectDescription source;  ///< its triangles
    Tree tree;
};
using RebuiltByObject = std::map<std::uint32_t, Rebuilt>;

/// Copies bytes on all threads.
void copy_bytes(std::byte* to, const std::byte* from, std::size_t count) {
    constexpr std::size_t part = 4U << 20;
    tbb::parallel_for(std::size_t{0}, (count + part - 1) / part, [&](std::size_t i) {
        std::memcpy(to + i * part, from + i * part, std::min(part, count - i * part));
    });
}

/// The triangles of an object, as a build wants them.
ObjectDescription triangles_of(const SceneView& view, const ObjectRecord& object) {
    ObjectDescription source;
    for (std::uint32_t i = 0; i < object.geometry_count; ++i) {
        const GeometryRecord& record = view.geometries[object.first_geometry + i];
        GeometryDescription& geometry = source.geometries.emplace_back();
        const auto take = [&]<class T>(std::vector<T>& list, std::uint64_t offset,
                                       std::uint64_t count) {
            if (offset == no_offset) return;
            const T* const first = view.attribute<T>(offset);
            list.assign(first, first + count);
        };
        take(geometry.positions, record.positions, record.vertex_count);
        take(geometry.indices, record.indices, std::uint64_t{3} * record.triangle_count);
        for (std::size_t set = 0; set < 2; ++set)
            take(geometry.texcoords[set], record.texcoords[set], record.vertex_count);
        geometry.material = record.material;
    }
    return source;
}

Rebuilt rebuilt(const Snapshot& scene, std::uint32_t index) {
    const SceneView& view = scene.view();
    Rebuilt made{view.objects[index], triangles_of(view, view.objects[index]), {}};
    ObjectRecord& object = made.record;
    const BuildQuality quality = scene.statistics().build;
    std::vector<Box> boxes(object.instance_count);
    std::vector<float> errors(object.instance_count);
    const ViewTrees trees(view);
    tbb::parallel_for(std::uint32_t{0}, object.instance_count, [&](std::uint32_t i) {
        const std::uint32_t child = view.instances[object.first_instance + i].object;
        const Transform& to_parent = view.instance_infos[object.first_instance + i].to_parent;
        errors[i] = placement_error(to_parent, view.objects[child].origin_error);
        boxes[i] = place_box(trees, child, to_parent, errors[i]).box;
    });
    made.tree = build_tree(
        {boxes, object.triangle_count, 0, object.instance_count, quality,
         quality == BuildQuality::high ? triangle_corners(made.source) : PageVector<Corners>(),
         triangle_boxes(made.source)});
    object.origin_error = 1;
    for (const float error : errors) object.origin_error = std::max(object.origin_error, error);
    object.root = made.tree.root;
    object.bounds = made.tree.bounds;
    object.node_count = static_cast<std::uint32_t>(made.tree.nodes.size());
    object.block_count = static_cast<std::uint32_t>(made.tree.block_lanes.size() / 8);
    return made;
}

/// Gives the objects their places in the sections of nodes and leaf blocks, and returns the elements of
/// these.
struct Sizes {
    std::uint64_t nodes = 0, blocks = 0;
};
Sizes lay_out(std::vector<ObjectRecord>& objects) {
    Sizes sizes;
    for (ObjectRecord& object : objects) {
        object.first_node = std::exchange(sizes.nodes, sizes.nodes + object.node_count);
        object.first_block = std::exchange(sizes.blocks, sizes.blocks + object.block_count);
    }
    return sizes;
}

Arena with_trees(const Snapshot& scene, const RebuiltByObject& rebuilt) {
    const SceneView& view = scene.view();
    const std::byte* const from = scene.bytes().data();
    const auto& old = *reinterpret_cast<const format::Header*>(from);
    std::vector<ObjectRecord> objects(view.objects, view.objects + view.object_count);
    for (const auto& [index, made] : rebuilt) objects[index] = made.record;
    const auto section = [](auto& header, Section which) -> auto& {
        return header.sections[static_cast<std::size_t>(which)];
    };
    const Sizes sizes = lay_out(objects);

    format::Header header = old;
    section(header, Section::nodes).count = sizes.nodes;
    section(header, Section::blocks).count = sizes.blocks;
    std::uint64_t end = format::aligned(sizeof header);
    for (format::SectionEntry& entry : header.sections) {
        entry.offset = end;
        end = format::aligned(end + entry.count * entry.element_size);
    }
    header.bytes = end;
    Arena arena(end);
    std::memcpy(arena.data(), &header, sizeof header);
    const auto at = [&]<class T>(Section which, const T*) {
        return reinterpret_cast<T*>(arena.data() + section(header, which).offset);
    };
    for (std::size_t s = 0; s < format::section_count; ++s) {
        const auto which = static_cast<Section>(s);
        if (which == Section::nodes || which == Section::blocks || which == Section::objects)
            continue;
        copy_bytes(arena.data() + header.sections[s].offset, from + old.sections[s].offset,
                   old.sections[s].count * old.sections[s].element_size);
    }
    std::ranges::copy(objects, at(Section::objects, view.objects));
    Node* const nodes = at(Section::nodes, view.nodes);
    TriangleBlock* const blocks = at(Section::blocks, view.blocks);
    std::byte* const attributes = at(Section::attributes, view.attributes);
    tbb::parallel_for(std::size_t{0}, objects.size(), [&](std::size_t i) {
        const ObjectRecord& before = view.objects[i];
        const ObjectRecord& object = objects[i];
        const auto known = rebuilt.find(static_cast<std::uint32_t>(i));
        if (known == rebuilt.end()) {
            std::copy_n(view.nodes + before.first_node, before.node_count,
                        nodes + object.first_node);
            std::copy_n(view.blocks + before.first_block, before.block_count,
                        blocks + object.first_block);
            return;
        }
        const auto& [record, source, tree] = known->second;
        std::ranges::copy(tree.nodes, nodes + object.first_node);
        TexcoordBlock* texcoords = nullptr;
        if (object.texcoord_blocks != no_offset) {
            texcoords = reinterpret_cast<TexcoordBlock*>(attributes + object.texcoord_blocks);
            std::fill_n(texcoords, object.block_count, TexcoordBlock{});
        }
        write_blocks(source, tree, {view.geometries + object.first_geometry, object.geometry_count},
                     view.materials, blocks + object.first_block, texcoords);
    });
    return arena;
}

}  // namespace

Result<std::shared_ptr<const Snapshot>> rebuild_trees(const Snapshot& scene,
                                                      std::span<const std::uint32_t> objects) {
    RebuiltByObject made;
    std::vector<TreeBuild> built = scene.trees_built();
    for (const std::uint32_t index : objects) {
        Rebuilt object = rebuilt(scene, index);
        const ObjectRecord& record = object.record;
        // Texture coordinates of alpha have room beside the leaf blocks that there are, and no more.
        const bool fits = record.block_count <= leaf_first_max + 1 &&
                          object.tree.height <= tree_height_max &&
                          (record.texcoord_blocks == no_offset ||
                           record.block_count <= scene.view().objects[index].block_count);
        if (fits) made.emplace(index, std::move(object));
        built[index] = {};
    }
    return Snapshot::reopen({with_trees(scene, made),
                             scene.statistics().build_seconds,
                             {.rebuilds = scene.statistics().edits.rebuilds + made.size()},
                             std::move(built)},
                            scene.digest());
}

}  // namespace raynest
