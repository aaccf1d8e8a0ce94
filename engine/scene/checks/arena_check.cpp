#include "engine/scene/checks/arena_check.h"

#include "engine/geometry/hit.h"
#include "engine/math/finite.h"
#include "engine/scene/checks/shading_check.h"
#include "engine/scene/checks/tree_check.h"
#include "engine/scene/format.h"
#include "engine/scene/motion/motion.h"
#include "engine/scene/snapshot.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numbers>
#include <string>
#include <vector>

namespace raynest {

tl::unexpected<Error> broken_arena(const std::string& what) {
    return fail(ErrorCode::scene_invalid, "the scene arena is broken: " + what);
}

namespace {

using format::Section;

class Checker {
public:
    explicit Checker(std::span<const std::byte> arena) : arena_(arena) {}

    Result<SceneView> check() {
        for (const auto step :
             {&Checker::check_header, &Checker::check_sections, &Checker::make_view,
              &Checker::check_names, &Checker::check_surfaces, &Checker::check_cameras,
              &Checker::check_objects, &Checker::check_paths, &Checker::check_lit,
              &Checker::check_motion}) {
            if (auto checked = (this->*step)(); !checked) return tl::unexpected(checked.error());
        }
        return view_;
    }

private:
    [[nodiscard]] std::uint64_t size_of(Section section) const {
        return format::section_size(arena_.data(), section);
    }
    template <class T>
    [[nodiscard]] const T* start_of(Section section) const {
        return format::section<T>(arena_.data(), section);
    }

    Result<void> check_header() {
        format::Header header;
        if (arena_.size() < sizeof header ||
            reinterpret_cast<std::uintptr_t>(arena_.data()) % format::alignment != 0) {
            return broken_arena("it is shorter than its header, or not aligned");
        }
        std::memcpy(&header, arena_.data(), sizeof header);
        if (header.magic != format::magic) return broken_arena("it does not start with RNSCENE");
        if (header.byte_order != format::byte_order)
            return broken_arena("its byte order is foreign");
        if (header.version != format::version) {
            return fail(ErrorCode::scene_unsupported,
                        "the scene arena has version " + std::to_string(header.version) +
                            ", this build reads version " + std::to_string(format::version) +
                            ": import the scene again");
        }
        if (header.build > BuildQuality::high) {
            return broken_arena("its build quality does not exist");
        }
        if (header.up > UpAxis::z) return broken_arena("its axis that points up does not exist");
        if (header.chosen_variant > header.variants)
            return broken_arena("its chosen variant does not exist");
        if (!is_origin(header.origin))
            return broken_arena("its origin is not finite or beyond 1e15");
        if (header.bytes != arena_.size())
            return broken_arena("its length is not what its header says");
        return {};
    }

    /// Refuses any layout of sections but the only valid one for their counts.
    Result<void> check_sections() {
        const auto& header = *reinterpret_cast<const format::Header*>(arena_.data());
        std::uint64_t end = format::aligned(sizeof header);
        for (std::size_t s = 0; s < format::section_count; ++s) {
            const format::SectionEntry& entry = header.sections[s];
            const bool sound = entry.offset == end && end <= arena_.size() && entry.unused == 0 &&
                               entry.element_size == format::element_size[s] &&
                               entry.count <= (arena_.size() - end) / entry.element_size;
            if (!sound)
                return broken_arena("section " + std::to_string(s) + " is not where it belongs");
            end = format::aligned(end + entry.count * entry.element_size);
        }
        if (end != arena_.size()) return broken_arena("bytes are left over");
        return {};
    }

    Result<void> make_view() {
        for (const Section section :
             {Section::objects, Section::instances, Section::geometries, Section::materials,
              Section::textures, Section::cameras, Section::path_nodes, Section::path_runs}) {
            if (size_of(section) >= no_id) return broken_arena("it has too many records");
        }
        const auto count = [&](Section section) {
            return static_cast<std::uint32_t>(size_of(section));
        };
        view_.nodes = start_of<Node>(Section::nodes);
        view_.blocks = start_of<TriangleBlock>(Section::blocks);
        view_.records = start_of<std::byte>(Section::records);
        view_.objects = start_of<ObjectRecord>(Section::objects);
        view_.instances = start_of<InstanceRecord>(Section::instances);
        view_.instance_infos = start_of<InstanceInfo>(Section::instance_infos);
        view_.geometries = start_of<GeometryRecord>(Section::geometries);
        view_.materials = start_of<MaterialRecord>(Section::materials);
        view_.textures = start_of<TextureRecord>(Section::textures);
        view_.cameras = start_of<CameraRecord>(Section::cameras);
        view_.attributes = start_of<std::byte>(Section::attributes);
        view_.names = start_of<char>(Section::names);
        view_.object_count = count(Section::objects);
        view_.instance_count = count(Section::instances);
        view_.geometry_count = count(Section::geometries);
        view_.material_count = count(Section::materials);
        view_.texture_count = count(Section::textures);
        view_.camera_count = count(Section::cameras);
        if (view_.object_count == 0) return broken_arena("it holds no object");
        if (size_of(Section::instance_infos) != view_.instance_count) {
            return broken_arena("instances and their names do not match");
        }
        view_.root = view_.object_count - 1;  // children are stored before their parents
        const auto& header = *reinterpret_cast<const format::Header*>(arena_.data());
        view_.cut_triangles = header.build == BuildQuality::high ? 1 : 0;
        return {};
    }

    /// True if the name starts in the section, and so ends there: the section's last byte is zero.
    [[nodiscard]] bool is_name(std::uint32_t offset) const {
        return offset < size_of(Section::names);
    }

    Result<void> check_names() {
        const std::uint64_t size = size_of(Section::names);
        if (size == 0 || view_.names[size - 1] != '\0') return broken_arena("its names do not end");
        for (std::uint64_t at = 0; at < size;) {
            const std::uint64_t length = std::strlen(view_.names + at);
            if (length > scene_name_bytes_max) return broken_arena("a name is too long");
            at += length + 1;
        }
        if (size_of(Section::warnings) > scene_warnings_max ||
            size_of(Section::skips) > scene_skips_max ||
            size_of(Section::record_types) > scene_record_types_max ||
            size_of(Section::cameras) > scene_cameras_max) {
            return broken_arena("it has too many warnings, skip reasons, record types or cameras");
        }
        if (reinterpret_cast<const format::Header*>(arena_.data())->variants >
            size_of(Section::warnings))
            return broken_arena("it has fewer warnings than variants");
        const auto* skips = start_of<format::SkipRecord>(Section::skips);
        for (std::uint64_t i = 0; i < size_of(Section::skips); ++i) {
            if (!is_name(skips[i].reason) || skips[i].unused != 0)
                return broken_arena("a skip reason");
        }
        for (const Section section : {Section::warnings, Section::record_types}) {
            const auto* names = start_of<format::NameOffset>(section);
            if (!std::all_of(names, names + size_of(section),
                             [&](std::uint32_t offset) { return is_name(offset); })) {
                return broken_arena("a name lies outside of it");
            }
        }
        const auto* types = start_of<format::NameOffset>(Section::record_types);
        for (std::uint64_t i = 0; i < size_of(Section::record_types); ++i)
            record_types_.push_back(primitive_type(view_.names + types[i]));
        return {};
    }

    /// True if a run of `count` elements fits into the attributes.
    [[nodiscard]] bool is_run(std::uint64_t offset, std::uint64_t count, std::uint64_t element,
                              std::uint64_t element_alignment) const {
        const std::uint64_t size = size_of(Section::attributes);
        return offset % element_alignment == 0 && offset <= size &&
               count <= (size - offset) / element;
    }

    Result<void> check_surfaces() {
        for (std::uint32_t i = 0; i < view_.texture_count; ++i) {
            const TextureRecord& texture = view_.textures[i];
            const std::uint64_t pixels = std::uint64_t{texture.width} * texture.height;
            const bool sound =
                pixels != 0 && texture.width <= texture_side_max &&
                texture.height <= texture_side_max && is_run(texture.colour, pixels, 4, 4) &&
                (texture.alpha == no_offset || is_run(texture.alpha, pixels, 1, 1)) &&
                texture.wrap_s <= Wrap::mirror && texture.wrap_t <= Wrap::mirror &&
                texture.nearest <= 1 && texture.unused == 0;
            if (!sound) return broken_arena("texture " + std::to_string(i));
        }
        for (std::uint32_t i = 0; i < view_.material_count; ++i) {
            const MaterialRecord& material = view_.materials[i];
            const Vec4& c = material.base_colour;
            const bool sound =
                (material.texture == no_id ||
                 (material.texture < view_.texture_count &&
                  view_.textures[material.texture].alpha != no_offset)) &&
                material.texcoord <= 1 && material.alpha_mode <= AlphaMode::blend &&
                material.double_sided <= 1 && is_name(material.name) &&
                std::isfinite(material.cutoff) && std::isfinite(c.x + c.y + c.z + c.w) &&
                std::all_of(std::begin(material.uv_transform), std::end(material.uv_transform),
                            [](float x) { return std::isfinite(x); });
            if (!sound) return broken_arena("material " + std::to_string(i));
            if (material.alpha_mode != AlphaMode::opaque) ++view_.masked_materials;
            if (material.alpha_mode == AlphaMode::blend) ++view_.blended_materials;
        }
        return {};
    }

    Result<void> check_motion() {
        auto read = read_motion({start_of<std::byte>(Section::motion), size_of(Section::motion)},
                                view_.objects[view_.root].instance_count, view_.camera_count,
                                static_cast<std::uint32_t>(size_of(Section::lights)));
        if (!read) return tl::unexpected(read.error());
        return {};
    }
    Result<void> check_lit() { return check_shading(arena_, view_); }

    Result<void> check_cameras() {
        for (std::uint32_t i = 0; i < view_.camera_count; ++i) {
            const CameraRecord& camera = view_.cameras[i];
            const bool perspective =
                camera.ymag == 0 && camera.yfov > 0 && camera.yfov < std::numbers::pi_v<float>;
            const bool orthographic =
                camera.ymag > 0 && std::isfinite(camera.ymag) && camera.yfov == 0;
            const bool sound = is_finite(camera.to_world.m) && (perspective || orthographic) &&
                               camera.aspect >= 0 && std::isfinite(camera.aspect) &&
                               is_name(camera.name);
            if (!sound) return broken_arena("camera " + std::to_string(i));
        }
        return {};
    }

    /// Checks that objects divide the sections among them, in order and without gaps.
    Result<void> check_objects() {
        std::uint64_t node = 0, block = 0, record = 0, geometry = 0, instance = 0;
        TreeChecker tree;
        for (std::uint32_t i = 0; i < view_.object_count; ++i) {
            const ObjectRecord& object = view_.objects[i];
            const std::string label = "object " + std::to_string(i);
            if (object.first_node != node || object.first_block != block ||
                object.first_record != record || object.first_geometry != geometry ||
                object.first_instance != instance || object.record_size > record_size_max) {
                return broken_arena(label + " does not start where the last one ended");
            }
            node += object.node_count;
            block += object.block_count;
            record += records_bytes(object);
            geometry += object.geometry_count;
            instance += object.instance_count;
            if (node > size_of(Section::nodes) || block > size_of(Section::blocks) ||
                record > size_of(Section::records) || geometry > view_.geometry_count ||
                instance > view_.instance_count) {
                return broken_arena(label + " leaves its sections");
            }
            const bool sound = is_name(object.name) && std::isfinite(object.origin_error) &&
                               object.origin_error >= 1 &&
                               (object.bounds.is_empty() ? object.root == child_empty
                                                         : is_finite(object.bounds.lower) &&
                                                               is_finite(object.bounds.upper));
            if (!sound) return broken_arena(label + " has a bad name, bound or error factor");
            for (const auto step : {&Checker::check_geometries, &Checker::check_texcoord_blocks,
                                    &Checker::check_records, &Checker::check_instances}) {
                if (auto checked = (this->*step)(object, i); !checked) return checked;
            }
            if (auto checked = tree.check(view_, object); !checked) return checked;
        }
        if (node != size_of(Section::nodes) || block != size_of(Section::blocks) ||
            record != size_of(Section::records) || geometry != view_.geometry_count ||
            instance != view_.instance_count) {
            return broken_arena("records belong to no object");
        }
        const Box& bounds = reinterpret_cast<const format::Header*>(arena_.data())->bounds;
        const bool is_empty = view_.objects[view_.root].bounds.is_empty();
        if (is_empty ? !bounds.is_empty() : !is_finite(bounds.lower) || !is_finite(bounds.upper))
            return broken_arena("its bounds are not finite");
        return {};
    }

    Result<void> check_geometries(const ObjectRecord& object, std::uint32_t) {
        std::uint64_t triangles = 0;
        for (std::uint32_t i = 0; i < object.geometry_count; ++i) {
            const GeometryRecord& geometry = view_.geometries[object.first_geometry + i];
            const auto optional_run = [&](std::uint64_t offset, std::uint64_t element,
                                          std::uint64_t element_alignment) {
                return offset == no_offset ||
                       is_run(offset, geometry.vertex_count, element, element_alignment);
            };
            const bool empty = geometry.triangle_count == 0;
            bool sound = geometry.first_triangle == triangles &&
                         (geometry.material == no_id || geometry.material < view_.material_count) &&
                         (empty || is_run(geometry.positions, geometry.vertex_count, 12, 4)) &&
                         (empty || is_run(geometry.indices, geometry.triangle_count, 12, 4)) &&
                         optional_run(geometry.texcoords[0], 8, 4) &&
                         optional_run(geometry.texcoords[1], 8, 4) &&
                         optional_run(geometry.colours, 4, 1) &&
                         (geometry.opacity == no_offset ||
                          is_run(geometry.opacity, geometry.triangle_count, 2, 1));
            if (sound && !empty) {
                const auto* indices = view_.attribute<std::uint32_t>(geometry.indices);
                sound = std::all_of(indices, indices + std::uint64_t{geometry.triangle_count} * 3,
                                    [&](std::uint32_t v) { return v < geometry.vertex_count; });
            }
            if (!sound)
                return broken_arena("geometry " + std::to_string(object.first_geometry + i));
            triangles += geometry.triangle_count;
        }
        if (triangles != object.triangle_count)
            return broken_arena("triangles belong to no geometry");
        return {};
    }

    /// Checks the blocks that kernels need if a candidate's alpha depends on a texture.
    Result<void> check_texcoord_blocks(const ObjectRecord& object, std::uint32_t index) {
        const GeometryRecord* const first = view_.geometries + object.first_geometry;
        const bool needed =
            object.block_count != 0 &&
            std::any_of(first, first + object.geometry_count, [&](const GeometryRecord& geometry) {
                return has_alpha_texture(geometry, view_.materials);
            });
        const bool sound = needed ? is_run(object.texcoord_blocks, object.block_count,
                                           sizeof(TexcoordBlock), format::alignment)
                                  : object.texcoord_blocks == no_offset;
        if (!sound)
            return broken_arena("the texture coordinates of object " + std::to_string(index));
        return {};
    }

    Result<void> check_records(const ObjectRecord& object, std::uint32_t) {
        if (object.record_count != 0 && object.triangle_count != 0) {
            return broken_arena("an object holds triangles and records");
        }
        if (object.record_count == 0) {
            if (object.record_type != 0 || object.record_size != 0)
                return broken_arena("a record type");
            return {};
        }
        const bool known = std::find(record_types_.begin(), record_types_.end(),
                                     object.record_type) != record_types_.end();
        if (!known || object.record_size == 0)
            return broken_arena("a record type has no name or size");
        for (std::uint32_t original = 0; original < object.record_count; ++original) {
            if (!is_record(object, original)) return broken_arena("a record's place");
        }
        return {};
    }

    /// True if a record's position and the index stored there refer to each other.
    [[nodiscard]] bool is_record(const ObjectRecord& object, std::uint32_t original) const {
        const std::uint64_t stride = record_stride(object.record_size);
        const std::byte* const entries = view_.records + object.first_record;
        std::uint32_t place = 0;
        std::memcpy(&place,
                    entries + object.record_count * stride + original * std::uint64_t{sizeof place},
                    sizeof place);
        if (place >= object.record_count) return false;
        std::uint32_t index = 0;
        std::memcpy(&index, entries + (place + 1) * stride - sizeof index, sizeof index);
        return index == original;
    }

    /// Checks instances. Children are stored before their parents, so there is no cycle, and sums
    /// over children are already checked.
    Result<void> check_instances(const ObjectRecord& object, std::uint32_t index) {
        std::uint64_t leaves = object.has_own_primitives() ? 1 : 0;
        std::uint32_t levels = 1;
        std::uint32_t mask = object.has_own_primitives() ? ~0U : 0;
        for (std::uint32_t i = 0; i < object.instance_count; ++i) {
            const InstanceRecord& instance = view_.instances[object.first_instance + i];
            const InstanceInfo& info = view_.instance_infos[object.first_instance + i];
            if (instance.object >= index || instance.path_base != leaves ||
                !is_finite(instance.to_object.m) || !is_finite(info.to_parent.m) ||
                !is_name(info.name) || instance.mask != (info.mask & masks_[instance.object])) {
                return broken_arena("instance " + std::to_string(object.first_instance + i));
            }
            const ObjectRecord& child = view_.objects[instance.object];
            if (child.placement_count > scene_paths_max - leaves)
                return broken_arena("it has more than 2^63 paths");
            leaves += child.placement_count;
            levels = std::max(levels, child.levels + 1);
            mask |= instance.mask;
        }
        masks_.push_back(mask);
        if (leaves != object.placement_count || levels != object.levels ||
            levels > scene_depth_max) {
            return broken_arena("the paths or levels of object " + std::to_string(index));
        }
        return {};
    }

    /// Checks that each path belongs to a run, each run to a node, each node to an earlier node.
    Result<void> check_paths() {
        const PathTable paths = format::path_table(arena_.data());
        const std::uint64_t numbers = size_of(Section::instance_numbers);
        if (numbers != 0 && (numbers != view_.instance_count || paths.node_count != 0))
            return broken_arena("instances and their numbers do not match");
        const std::uint64_t leaves = view_.objects[view_.root].placement_count;
        if (paths.node_count == 0) {
            if (paths.run_count != 0) return broken_arena("its paths have no nodes");
            return {};
        }
        if (leaves != 0 && (paths.run_count == 0 || paths.runs[0].first_path != 0))
            return broken_arena("its paths do not start at 0");
        for (std::uint32_t i = 0; i < paths.node_count; ++i) {
            const PathNode& node = paths.nodes[i];
            const std::uint32_t first = node.first_run;
            const bool sound = is_name(node.name) &&
                               (i == 0 ? node.parent == 0 : node.parent < i) &&
                               (i < 2 || paths.nodes[i - 1].parent <= node.parent) &&
                               (first == no_id ||
                                (i != 0 && first < paths.run_count && paths.runs[first].node == i));
            if (!sound) return broken_arena("path node " + std::to_string(i));
        }
        for (std::uint32_t r = 0; r < paths.run_count; ++r) {
            const PathRun& run = paths.runs[r];
            const std::uint64_t end =
                r + 1 < paths.run_count ? paths.runs[r + 1].first_path : leaves;
            const bool sound = run.node < paths.node_count && run.first_path < end &&
                               end - run.first_path <= no_id - run.number &&
                               (paths.nodes[run.node].first_run == r ||
                                (r != 0 && paths.runs[r - 1].node == run.node));
            if (!sound) return broken_arena("path run " + std::to_string(r));
        }
        return {};
    }

    std::span<const std::byte> arena_;
    SceneView view_;
    std::vector<std::uint32_t> masks_;         ///< by object: the union of those inside
    std::vector<std::uint32_t> record_types_;  ///< in the order in which objects use them
};

}  // namespace

Result<SceneView> check_arena(std::span<const std::byte> arena) {
    return Checker(arena).check();
}

}  // namespace raynest
