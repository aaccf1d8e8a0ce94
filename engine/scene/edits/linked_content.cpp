#include "engine/scene/edits/linked_content.h"

#include "engine/bvh/build.h"
#include "engine/scene/edits/view_trees.h"
#include "engine/scene/path_table.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstring>

namespace raynest {
namespace {

using format::Section;

/// Returns where a section begins in an arena that is being written.
template <class T>
T* place_of(Arena& arena, Section section) {
    return const_cast<T*>(format::section<T>(arena.data(), section));
}

template <class T>
std::span<const std::byte> bytes_of(const T* first, std::uint64_t count) {
    return {reinterpret_cast<const std::byte*>(first), count * sizeof(T)};
}

bool equal(std::span<const std::byte> a, std::span<const std::byte> b) {
    return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size()) == 0);
}

/// The bytes of records without padding, as a key.
template <class... Records>
std::string key_of(const Records&... records) {
    std::string key;
    (key.append(reinterpret_cast<const char*>(&records), sizeof records), ...);
    return key;
}

std::uint64_t bytes_of_levels(const TextureRecord& texture, const TextureLevels& levels) {
    std::uint64_t bytes = 0;
    for (std::uint32_t k = 1; k < levels.count; ++k)
        bytes +=
            std::uint64_t{4} * std::max(texture.width >> k, 1U) * std::max(texture.height >> k, 1U);
    return bytes;
}

/// Calls visit(offset, bytes) for each run of a geometry. `shading` is the record beside
/// `geometry`.
template <class Geometry, class Shading, class Visit>
void each_run(Geometry& geometry, Shading& shading, Visit&& visit) {
    const std::uint64_t vertices = geometry.vertex_count;
    const std::uint64_t triangles = geometry.triangle_count;
    visit(geometry.positions, 12 * vertices);
    visit(geometry.indices, 12 * triangles);
    visit(geometry.texcoords[0], 8 * vertices);
    visit(geometry.texcoords[1], 8 * vertices);
    visit(geometry.colours, 4 * vertices);
    visit(geometry.opacity, sizeof(Opacity) * triangles);
    visit(shading.normals, 12 * vertices);
    visit(shading.tangents, 16 * vertices);
}

}  // namespace

LinkedContent::LinkedContent(const Snapshot& base) {
    const SceneView& view = base.view();
    const std::byte* const arena = base.bytes().data();
    const auto& header = *reinterpret_cast<const format::Header*>(arena);
    content_.build = header.build;
    content_.up = header.up;
    content_.chosen_variant = header.chosen_variant;
    content_.variants = header.variants;
    content_.origin = header.origin;
    content_.degenerate_triangles = header.degenerate_triangles;
    content_.bounds = header.bounds;
    // The names keep their offsets: each is there once.
    for (std::uint64_t at = 0; at < base.paths().names_bytes;
         at += std::strlen(view.names + at) + 1)
        content_.names.add(view.names + at);
    const auto take = [&]<class T>(Section section, std::vector<T>& out) {
        const T* const first = format::section<T>(arena, section);
        out.assign(first, first + format::section_size(arena, section));
    };
    take(Section::cameras, content_.cameras);
    take(Section::lights, content_.lights);
    take(Section::motion, content_.motion);
    take(Section::skips, content_.skips);
    take(Section::warnings, content_.warnings);
    Scene& scene = scenes_.emplace_back(Scene{&base, std::vector(view.object_count, no_id), {}});
    add_materials(scene, true);
    if (base.paths().numbers != nullptr)
        scene.numbers.assign(base.paths().numbers, base.paths().numbers + view.instance_count);
}

std::size_t LinkedContent::add_scene(const Snapshot& snapshot) {
    const SceneView& view = snapshot.view();
    Scene& scene =
        scenes_.emplace_back(Scene{&snapshot, std::vector(view.object_count, no_id), {}});
    add_materials(scene, false);
    // Trees of a high build may name a triangle in several leaves, which kernels have to know.
    content_.build = std::max(content_.build, snapshot.statistics().build);
    content_.degenerate_triangles += snapshot.statistics().degenerate_triangles;
    if (snapshot.paths().node_count == 0) {
        if (snapshot.paths().numbers != nullptr)
            scene.numbers.assign(snapshot.paths().numbers,
                                 snapshot.paths().numbers + view.instance_count);
        return scenes_.size() - 1;
    }
    // Nodes named the paths; now the objects do.
    for (std::uint32_t i = 0; i < view.object_count; ++i) {
        const ObjectRecord& object = view.objects[i];
        std::vector<std::uint32_t> names;
        for (std::uint32_t k = 0; k < object.instance_count; ++k) {
            const std::uint32_t child = view.instances[object.first_instance + k].object;
            names.push_back(
                content_.names.add(path_step_text(view.names + view.objects[child].name)));
        }
        const std::vector<std::uint32_t> numbers = number_siblings(names);
        scene.numbers.insert(scene.numbers.end(), numbers.begin(), numbers.end());
    }
    return scenes_.size() - 1;
}

std::uint32_t LinkedContent::name(const Snapshot& scene, std::uint32_t offset) {
    return content_.names.add(scene.view().names + offset);
}

std::span<const std::byte> LinkedContent::run(const Scene& scene, std::uint64_t offset,
                                              std::uint64_t bytes) const {
    if (offset == no_offset) return {};
    return {scene.snapshot->view().attributes + offset, bytes};
}

std::uint64_t LinkedContent::add_run(Scene& scene, std::uint64_t offset, std::uint64_t bytes) {
    if (offset == no_offset || bytes == 0) return offset == no_offset ? no_offset : 0;
    const auto [at, added] = scene.runs.try_emplace(offset, 0);
    if (added) at->second = content_.attributes.add(run(scene, offset, bytes));
    return at->second;
}

std::uint32_t LinkedContent::add_texture(Scene& scene, std::uint32_t number) {
    const TextureRecord& texture = scene.snapshot->view().textures[number];
    const TextureLevels& levels = scene.snapshot->shading().levels[number];
    const std::uint64_t pixels = std::uint64_t{texture.width} * texture.height;
    TextureRecord without = texture;
    without.colour = 0;
    without.alpha = texture.alpha == no_offset ? 0 : 1;
    const std::string key = key_of(without, levels.count, levels.linear);
    const auto colours = run(scene, texture.colour, 4 * pixels);
    auto& alike = known_textures_[key];
    for (const auto& [known, known_colours] : alike)
        if (equal(colours, known_colours)) return known;
    const auto made = static_cast<std::uint32_t>(content_.textures.size());
    alike.emplace_back(made, colours);
    TextureRecord record = texture;
    record.colour = add_run(scene, texture.colour, 4 * pixels);
    record.alpha = add_run(scene, texture.alpha, pixels);
    TextureLevels smaller = levels;
    smaller.offset = add_run(scene, levels.offset, bytes_of_levels(texture, levels));
    content_.textures.push_back(record);
    content_.texture_levels.push_back(smaller);
    return made;
}

void LinkedContent::add_materials(Scene& scene, bool is_base) {
    const SceneView& view = scene.snapshot->view();
    std::vector<std::uint32_t> textures(view.texture_count, no_id);
    const auto texture = [&](std::uint32_t& number) {
        if (number == no_id) return;
        if (textures[number] == no_id) textures[number] = add_texture(scene, number);
        number = textures[number];
    };
    for (std::uint32_t i = 0; i < view.material_count; ++i) {
        MaterialRecord material = view.materials[i];
        SurfaceRecord surface = scene.snapshot->shading().surfaces[i];
        material.name = name(*scene.snapshot, material.name);
        texture(material.texture);
        for (TextureUse& use : surface.textures) texture(use.texture);
        const auto made = static_cast<std::uint32_t>(content_.materials.size());
        const auto [known, added] = known_materials_.try_emplace(key_of(material, surface), made);
        scene.materials.push_back(is_base ? made : known->second);
        if (!added && !is_base) continue;
        content_.materials.push_back(material);
        content_.surfaces.push_back(surface);
    }
}

std::uint32_t LinkedContent::keep(std::size_t scene, std::uint32_t object) {
    if (scenes_[scene].objects[object] != no_id) return scenes_[scene].objects[object];
    const SceneView& view = scenes_[scene].snapshot->view();
    const ObjectRecord& record = view.objects[object];
    std::vector<std::uint32_t> children;
    for (std::uint32_t i = 0; i < record.instance_count; ++i)
        children.push_back(keep(scene, view.instances[record.first_instance + i].object));
    return scenes_[scene].objects[object] = add_object(scene, object, children, scene != 0);
}

std::uint32_t LinkedContent::copy(std::size_t scene, std::uint32_t object,
                                  const std::vector<std::uint32_t>& children) {
    return add_object(scene, object, children, false);
}

bool LinkedContent::is_same(std::uint32_t known, const Scene& scene, const ObjectRecord& object,
                            const Instances& instances) const {
    const Origin& origin = origins_[known];
    const Scene& other = scenes_[origin.scene];
    const SceneView& a = other.snapshot->view();
    const SceneView& b = scene.snapshot->view();
    const ObjectRecord& same = a.objects[origin.object];
    if (!equal(bytes_of(a.nodes + same.first_node, same.node_count),
               bytes_of(b.nodes + object.first_node, object.node_count)) ||
        !equal(bytes_of(a.blocks + same.first_block, same.block_count),
               bytes_of(b.blocks + object.first_block, object.block_count)) ||
        !equal({a.records + same.first_record, records_bytes(same)},
               {b.records + object.first_record, records_bytes(object)}))
        return false;
    const std::uint32_t first = content_.objects[known].first_instance;
    const auto is_at = [first]<class T>(const std::vector<T>& all, const std::vector<T>& wanted) {
        return equal(bytes_of(all.data() + first, wanted.size()),
                     bytes_of(wanted.data(), wanted.size()));
    };
    if (!is_at(content_.instances, instances.records) ||
        !is_at(content_.instance_infos, instances.infos) || !is_at(numbers_, instances.numbers))
        return false;
    for (std::uint32_t i = 0; i < object.geometry_count; ++i) {
        const std::uint32_t ours = same.first_geometry + i;
        const std::uint32_t theirs = object.first_geometry + i;
        const GeometryRecord& x = a.geometries[ours];
        const GeometryRecord& y = b.geometries[theirs];
        const auto material = [](const Scene& of, std::uint32_t m) {
            return m == no_id ? no_id : of.materials[m];
        };
        if (x.triangle_count != y.triangle_count || x.vertex_count != y.vertex_count ||
            material(other, x.material) != material(scene, y.material))
            return false;
        std::vector<std::span<const std::byte>> runs;
        each_run(x, other.snapshot->shading().geometries[ours],
                 [&](std::uint64_t offset, std::uint64_t bytes) {
                     runs.push_back(run(other, offset, bytes));
                 });
        std::size_t at = 0;
        bool alike = true;
        each_run(y, scene.snapshot->shading().geometries[theirs],
                 [&](std::uint64_t offset, std::uint64_t bytes) {
                     alike = alike && equal(runs[at++], run(scene, offset, bytes));
                 });
        if (!alike) return false;
    }
    return true;
}

void LinkedContent::add_geometries(Scene& scene, const ObjectRecord& object) {
    const SceneView& view = scene.snapshot->view();
    for (std::uint32_t i = 0; i < object.geometry_count; ++i) {
        GeometryRecord geometry = view.geometries[object.first_geometry + i];
        GeometryShading shading = scene.snapshot->shading().geometries[object.first_geometry + i];
        // Each copy has runs of its own, because its vertices may move.
        each_run(geometry, shading, [&](std::uint64_t& offset, std::uint64_t bytes) {
            if (offset != no_offset) offset = content_.attributes.add(run(scene, offset, bytes));
        });
        if (geometry.material != no_id) geometry.material = scene.materials[geometry.material];
        content_.geometries.push_back(geometry);
        content_.geometry_shading.push_back(shading);
    }
}

std::uint32_t LinkedContent::add_object(std::size_t number, std::uint32_t index,
                                        const std::vector<std::uint32_t>& children,
                                        bool may_share) {
    Scene& scene = scenes_[number];
    const SceneView& view = scene.snapshot->view();
    const ObjectRecord& record = view.objects[index];
    ObjectRecord object = record;
    object.name = name(*scene.snapshot, record.name);
    object.texcoord_blocks = record.texcoord_blocks == no_offset ? no_offset : 0;
    object.first_node = object.first_block = object.first_record = 0;
    object.first_geometry = object.first_instance = 0;
    Instances instances;
    const bool by_objects = scene.snapshot->paths().node_count != 0;
    for (std::uint32_t i = 0; i < record.instance_count; ++i) {
        const std::uint32_t at = record.first_instance + i;
        InstanceInfo info = view.instance_infos[at];
        info.name = by_objects ? content_.names.add(path_step_text(
                                     view.names + view.objects[view.instances[at].object].name))
                               : name(*scene.snapshot, info.name);
        instances.infos.push_back(info);
        instances.records.push_back(view.instances[at]);
        instances.records.back().object = children[i];
        instances.numbers.push_back(scene.numbers.empty() ? no_id : scene.numbers[at]);
    }
    auto& alike = alike_[key_of(object)];
    if (may_share)
        for (const std::uint32_t known : alike)
            if (is_same(known, scene, record, instances)) return known;

    object.first_node = std::exchange(nodes_, nodes_ + object.node_count);
    object.first_block = std::exchange(blocks_, blocks_ + object.block_count);
    object.first_record = std::exchange(record_bytes_, record_bytes_ + records_bytes(record));
    object.first_geometry = static_cast<std::uint32_t>(content_.geometries.size());
    object.first_instance = static_cast<std::uint32_t>(content_.instances.size());
    if (object.texcoord_blocks != no_offset)
        object.texcoord_blocks =
            content_.attributes.reserve(object.block_count * sizeof(TexcoordBlock));
    add_geometries(scene, record);
    const auto append = []<class T>(std::vector<T>& all, const std::vector<T>& more) {
        all.insert(all.end(), more.begin(), more.end());
    };
    append(content_.instances, instances.records);
    append(content_.instance_infos, instances.infos);
    append(numbers_, instances.numbers);
    if (record.record_type != 0) {
        const auto& types = scene.snapshot->record_types();
        const auto type = std::ranges::find_if(types, [&](const std::string& known) {
            return primitive_type(known.c_str()) == record.record_type;
        });
        const std::uint32_t offset = content_.names.add(*type);
        if (std::ranges::find(content_.record_types, offset) == content_.record_types.end())
            content_.record_types.push_back(offset);
    }
    const auto made = static_cast<std::uint32_t>(content_.objects.size());
    alike.push_back(made);
    content_.objects.push_back(object);
    origins_.push_back({number, index});
    return made;
}

std::vector<TreeBuild> LinkedContent::trees_built() const {
    std::vector<TreeBuild> built;
    for (const Origin& origin : origins_)
        built.push_back(scenes_[origin.scene].snapshot->trees_built()[origin.object]);
    built.resize(content_.objects.size());
    return built;
}

std::uint32_t LinkedContent::mask_of(std::uint32_t object) const {
    const ObjectRecord& record = content_.objects[object];
    std::uint32_t mask = record.has_own_primitives() ? ~0U : 0;
    for (std::uint32_t i = 0; i < record.instance_count; ++i)
        mask |= content_.instances[record.first_instance + i].mask;
    return mask;
}

ObjectTree LinkedContent::tree(std::uint32_t object) const {
    if (object == origins_.size())
        return {root_tree_.nodes.data(), root_tree_.root,
                static_cast<std::uint32_t>(root_tree_.nodes.size()), root_tree_.bounds};
    const Origin& origin = origins_[object];
    return ViewTrees(scenes_[origin.scene].snapshot->view()).tree(origin.object);
}

TreePlacement LinkedContent::placement(std::uint32_t object, std::uint32_t place) const {
    const std::size_t at = content_.objects[object].first_instance + place;
    return {content_.instances[at].object, content_.instance_infos[at].to_parent};
}

double LinkedContent::padding(std::uint32_t object, std::uint32_t place) const {
    const auto [child, to_parent] = placement(object, place);
    const float error = placement_error(to_parent, content_.objects[child].origin_error);
    return placed_padding(content_.objects[child].bounds, to_parent, error);
}

double LinkedContent::farthest_in_leaf(std::uint32_t object, std::uint32_t leaf, const Reach& reach,
                                       double most) const {
    const Origin& origin = origins_[object];
    return ViewTrees(scenes_[origin.scene].snapshot->view())
        .farthest_in_leaf(origin.object, leaf, reach, most);
}

Result<void> LinkedContent::add_root(std::uint32_t name, std::vector<Placed> instances) {
    if (instances.size() > leaf_instance_max)
        return fail(
            ErrorCode::limit_exceeded,
            fmt::format("the scene would have {} outermost instances, at most {} fit into one tree",
                        instances.size(), leaf_instance_max));
    ObjectRecord root{};
    root.name = name;
    root.levels = 1;
    root.origin_error = 1;
    root.texcoord_blocks = no_offset;
    root.first_node = nodes_;
    root.first_block = blocks_;
    root.first_record = record_bytes_;
    root.first_geometry = static_cast<std::uint32_t>(content_.geometries.size());
    root.first_instance = static_cast<std::uint32_t>(content_.instances.size());
    root.instance_count = static_cast<std::uint32_t>(instances.size());
    std::vector<Box> boxes(instances.size());
    std::vector<float> errors(instances.size());
    std::unordered_map<std::uint32_t, std::uint32_t> contents;  // by object
    for (const Placed& placed : instances) {
        const ObjectRecord& child = content_.objects[placed.object];
        InstanceRecord record{};
        Transform to_object;
        invert(placed.to_parent, to_object);  // the caller has checked it
        record.to_object = by_columns(to_object);
        record.object = placed.object;
        const auto [mask, is_new] = contents.try_emplace(placed.object);
        if (is_new) mask->second = mask_of(placed.object);
        record.mask = placed.mask & mask->second;
        record.path_base = root.placement_count;
        if (child.placement_count > scene_paths_max - root.placement_count)
            return fail(ErrorCode::limit_exceeded, "the scene would place more than 2^63 leaves");
        root.placement_count += child.placement_count;
        root.levels = std::max(root.levels, child.levels + 1);
        content_.instances.push_back(record);
        content_.instance_infos.push_back({placed.to_parent, placed.uid, placed.name, placed.mask});
        numbers_.push_back(placed.number);
    }
    if (root.levels > scene_depth_max)
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("the scene would nest more than {} levels", scene_depth_max));
    tbb::parallel_for(std::size_t{0}, instances.size(), [&](std::size_t i) {
        const Placed& placed = instances[i];
        errors[i] = placement_error(placed.to_parent, content_.objects[placed.object].origin_error);
        boxes[i] = place_box(*this, placed.object, placed.to_parent, errors[i]).box;
    });
    if (!std::ranges::all_of(boxes, in_range))
        return fail(ErrorCode::field_invalid, "an added instance would reach beyond 1e15");
    for (const float error : errors) root.origin_error = std::max(root.origin_error, error);
    root_tree_ = build_tree({boxes, 0, 0, root.instance_count, content_.build});
    root.root = root_tree_.root;
    root.bounds = root_tree_.bounds;
    root.node_count = static_cast<std::uint32_t>(root_tree_.nodes.size());
    content_.objects.push_back(root);
    content_.bounds = vertex_bounds(*this, static_cast<std::uint32_t>(content_.objects.size() - 1),
                                    content_.instances.size());
    return {};
}

Result<Arena> LinkedContent::write(bool has_nodes) {
    if (content_.names.bytes().size() >= no_id || content_.instances.size() >= no_id ||
        content_.geometries.size() >= no_id)
        return fail(
            ErrorCode::limit_exceeded,
            "the scene would have more than 2^32 instances or geometries, or 4 GiB of names");
    if (has_nodes) {
        for (InstanceInfo& info : content_.instance_infos) info.name = 0;
    } else if (!std::ranges::all_of(numbers_, [](std::uint32_t n) { return n == no_id; })) {
        content_.instance_numbers = numbers_;
    }
    Arena arena = write_arena(content_);
    tbb::parallel_for(std::size_t{0}, content_.objects.size(), [&](std::size_t i) {
        const ObjectRecord& object = content_.objects[i];
        const auto copy = [](void* to, const void* from, std::uint64_t bytes) {
            if (bytes != 0) std::memcpy(to, from, bytes);
        };
        Node* const nodes = place_of<Node>(arena, Section::nodes) + object.first_node;
        if (i == origins_.size()) {
            copy(nodes, root_tree_.nodes.data(), object.node_count * sizeof(Node));
            return;
        }
        const SceneView& view = scenes_[origins_[i].scene].snapshot->view();
        const ObjectRecord& from = view.objects[origins_[i].object];
        copy(nodes, view.nodes + from.first_node, from.node_count * sizeof(Node));
        copy(place_of<TriangleBlock>(arena, Section::blocks) + object.first_block,
             view.blocks + from.first_block, from.block_count * sizeof(TriangleBlock));
        copy(place_of<std::byte>(arena, Section::records) + object.first_record,
             view.records + from.first_record, records_bytes(from));
        if (from.texcoord_blocks != no_offset)
            copy(place_of<std::byte>(arena, Section::attributes) + object.texcoord_blocks,
                 view.attributes + from.texcoord_blocks, from.block_count * sizeof(TexcoordBlock));
    });
    return arena;
}

}  // namespace raynest
