// Meshes: a glTF primitive becomes one geometry, and a mesh becomes one object.
//
// Triangles, strips and fans become triangle lists in file order. Points and lines are counted and
// leave an empty geometry, so that a hit's geometry index is the primitive's. A mesh of nothing but
// points with `_RADIUS`, as an export writes them, is one of spheres. Primitives often
// share one large vertex buffer, so each takes only the vertices it uses.
#include "engine/assets/gltf/budget.h"
#include "engine/assets/gltf/describe.h"
#include "engine/assets/gltf/facing.h"
#include "engine/assets/gltf/skins.h"
#include "engine/assets/input/messages.h"
#include "engine/geometry/sphere_shape.h"
#include "engine/scene/motion/skinning.h"
#include "engine/scene/snapshot.h"
#include "engine/scene/texture_levels.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>

namespace raynest::gltf {
namespace {

enum Mode {
    mode_points = 0,
    mode_lines_last = 3,
    mode_triangles = 4,
    mode_strip = 5,
    mode_fan = 6
};

/// Returns corner c of triangle i of a list, strip or fan, as a place in the index list. Strips
/// reverse every other triangle; fans start at corner 0 (glTF 2.0, 3.7.2.1).
std::uint64_t corner(int mode, std::uint64_t i, std::uint64_t c) {
    if (mode == mode_strip) return c == 0 ? i : (c == 1) == (i % 2 == 0) ? i + 1 : i + 2;
    if (mode == mode_fan) return c == 2 ? 0 : i + c + 1;
    return 3 * i + c;
}

class MeshReader {
public:
    MeshReader(const Model& model, const ImportLimits& limits, MotionWriter& motion,
               SceneDescription& scene)
        : model_(model),
          limits_(limits),
          motion_(motion),
          scene_(scene),
          budget_(model, limits),
          deformer_(model, budget_) {}

    Result<ObjectDescription> read(std::size_t index) {
        const Mesh& mesh = model_.meshes[index];
        const std::size_t in_file = mesh.pose_of == no_id ? index : mesh.pose_of;
        where_ = label("mesh", in_file, mesh.name);
        ObjectDescription object;
        object.name = mesh.name;
        MotionWriter* const motion = motion_.deforms(index) ? &motion_ : nullptr;
        if (motion != nullptr) motion->begin_mesh(static_cast<std::uint32_t>(index));
        const std::vector<Primitive>& primitives = model_.meshes[in_file].primitives;
        if (motion == nullptr && !primitives.empty() &&
            std::ranges::all_of(primitives, is_of_spheres)) {
            for (const Primitive& primitive : primitives)
                if (auto done = add_spheres(mesh, primitive, object); !done) return error_of(done);
            return object;
        }
        for (const Primitive& primitive : primitives) {
            if (primitive.mode < mode_points || primitive.mode > mode_fan) {
                return refuse(
                    fmt::format("has a primitive with the unknown mode {}", primitive.mode));
            }
            if (motion != nullptr) {
                if (auto done = budget_.take_bytes(motion->part_bytes()); !done)
                    return error_of(done);
                motion->begin_part();
            }
            if (primitive.mode <= mode_lines_last) {
                ++scene_.skipped[primitive.mode == mode_points ? "points" : "lines"];
                object.geometries.emplace_back();
                if (motion != nullptr) motion->end_part(0);
                continue;
            }
            auto geometry = read_primitive(mesh, primitive, motion);
            if (!geometry) return error_of(geometry);
            if (geometry->indices.empty()) geometry = GeometryDescription{};
            if (motion != nullptr)
                motion->end_part(static_cast<std::uint32_t>(geometry->positions.size()));
            object.geometries.push_back(std::move(*geometry));
        }
        facing_.end_mesh(where_);
        return object;
    }

    void warn_of_normals() {
        for (std::string& line : facing_.warnings()) scene_.warnings.push_back(std::move(line));
    }

private:
    static bool is_of_spheres(const Primitive& primitive) {
        return primitive.mode == mode_points && primitive.radius != no_id &&
               primitive.position != no_id && primitive.indices == no_id;
    }

    Result<void> add_spheres(const Mesh& mesh, const Primitive& primitive,
                             ObjectDescription& object) {
        const Accessor& position = model_.accessors[primitive.position];
        const Accessor& radius = model_.accessors[primitive.radius];
        if (!position.fault.empty()) return refuse("needs " + position.fault);
        const std::vector<std::uint32_t> all;
        const Deformed deformed{where_, mesh, primitive,
                                [&](const Accessor& accessor, bool type_allowed, const char* name) {
                                    return read_attribute(accessor, position, all, type_allowed,
                                                          name);
                                },
                                nullptr};
        if (auto done = budget_.take_triangles(position.count, limits_.triangles_max); !done)
            return done;
        if (auto done = budget_.take_bytes(position.count * (sizeof(Sphere) + sizeof(Box))); !done)
            return done;
        GeometryDescription geometry;
        if (auto done = read_positions(deformed, geometry); !done) return done;
        if (auto done = check_positions(geometry); !done) return done;
        if (auto done = read_colours(deformed, geometry); !done) return done;
        const auto radii = deformed.read(
            radius, radius.width == 1 && radius.component == Component::f32, "_RADIUS");
        if (!radii) return error_of(radii);
        const std::size_t before = object.record_bounds.size();
        object.record_type = "sphere";
        object.records.resize((before + radii->size()) * sizeof(Sphere));
        for (std::size_t i = 0; i < radii->size(); ++i) {
            const Sphere sphere{geometry.positions[i], (*radii)[i]};
            if (!(sphere.radius > 0 && sphere.radius <= coordinate_max))
                return refuse(fmt::format("has a _RADIUS of {}", sphere.radius));
            object.record_bounds.push_back(bounds(sphere));
            std::memcpy(object.records.data() + (before + i) * sizeof(Sphere), &sphere,
                        sizeof(Sphere));
        }
        if (!geometry.colours.empty()) object.record_colours.resize(4 * before, 255);
        if (!geometry.colours.empty() || !object.record_colours.empty())
            geometry.colours.resize(4 * radii->size(), 255);
        object.record_colours.insert(object.record_colours.end(), geometry.colours.begin(),
                                     geometry.colours.end());
        return {};
    }

    tl::unexpected<Error> refuse(const std::string& why) const {
        return fail(ErrorCode::scene_invalid, where_ + ' ' + why);
    }

    Result<GeometryDescription> read_primitive(const Mesh& mesh, const Primitive& primitive,
                                               MotionWriter* motion) {
        if (primitive.position == no_id) return refuse("has a primitive without POSITION");
        const Accessor& position = model_.accessors[primitive.position];
        if (!position.fault.empty()) return refuse("needs " + position.fault);
        if (position.count > 0xFFFFFFFEU) return refuse("has too many vertices");
        GeometryDescription geometry;
        geometry.material = primitive.material;
        std::vector<std::uint32_t> vertices;  // those in use; empty means all
        if (auto done = read_triangles(primitive, position, geometry, vertices); !done) {
            return error_of(done);
        }
        const Deformed deformed{where_, mesh, primitive,
                                [&](const Accessor& accessor, bool type_allowed, const char* name) {
                                    return read_attribute(accessor, position, vertices,
                                                          type_allowed, name);
                                },
                                motion};
        if (auto done = read_positions(deformed, geometry); !done) return error_of(done);
        for (std::size_t set = 0; set < 2; ++set) {
            if (auto done = read_texcoords(deformed, set, geometry.texcoords[set]); !done) {
                return error_of(done);
            }
        }
        if (auto done = read_colours(deformed, geometry); !done) return error_of(done);
        if (auto done = read_normals(deformed, geometry); !done) return error_of(done);
        if (mesh.skin != no_id) {
            if (auto done = deformer_.skin(deformed, geometry); !done) return error_of(done);
        }
        if (auto done = check_positions(geometry); !done) return error_of(done);
        facing_.count(geometry);
        warn_of_texture(geometry);
        return geometry;
    }

    void warn_of_texture(const GeometryDescription& geometry) {
        if (geometry.material == no_id || geometry.indices.empty()) return;
        const MaterialDescription& material = model_.materials[geometry.material];
        if (material.texture == no_id || material.texcoord > 1 ||
            !geometry.texcoords[material.texcoord].empty())
            return;
        leave_out(
            scene_, "textures",
            fmt::format("{} has no TEXCOORD_{}, which {} needs; its texture is left out there",
                        where_, material.texcoord,
                        label("material", geometry.material, material.name)));
    }

    Result<void> read_triangles(const Primitive& primitive, const Accessor& position,
                                GeometryDescription& geometry,
                                std::vector<std::uint32_t>& vertices) {
        const bool indexed = primitive.indices != no_id;
        const std::uint64_t corners =
            indexed ? model_.accessors[primitive.indices].count : position.count;
        const bool list = primitive.mode == mode_triangles;
        const std::uint64_t triangles = list ? corners / 3 : corners < 3 ? 0 : corners - 2;
        if (auto done = budget_.take_triangles(triangles, limits_.triangles_max); !done)
            return done;
        if (auto done = budget_.take_bytes(corners * 4 + triangles * 12); !done) return done;

        std::vector<std::uint32_t> list_indices;
        if (indexed) {
            auto indices = read_indices(model_.accessors[primitive.indices]);
            if (!indices) return blame(where_, indices.error());
            const std::uint32_t highest = *std::max_element(indices->begin(), indices->end());
            if (highest >= position.count) {
                return refuse(fmt::format("uses vertex {} of {}", highest, position.count));
            }
            list_indices = std::move(*indices);
        }

        // When most of a shared vertex buffer belongs to other primitives, take only the vertices
        // in use.
        if (indexed && list_indices.size() < position.count) {
            vertices = list_indices;
            std::sort(vertices.begin(), vertices.end());
            vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
            for (std::uint32_t& index : list_indices) {
                index = static_cast<std::uint32_t>(
                    std::lower_bound(vertices.begin(), vertices.end(), index) - vertices.begin());
            }
        }
        geometry.indices.resize(triangles * 3);
        for (std::uint64_t i = 0; i < triangles; ++i) {
            for (std::uint64_t c = 0; c < 3; ++c) {
                const std::uint64_t at = corner(primitive.mode, i, c);
                geometry.indices[3 * i + c] =
                    indexed ? list_indices[at] : static_cast<std::uint32_t>(at);
            }
        }
        return {};
    }

    /// Reads an attribute as floats, after checking its type and that it has one element per
    /// vertex.
    Result<std::vector<float>> read_attribute(const Accessor& accessor, const Accessor& position,
                                              const std::vector<std::uint32_t>& vertices,
                                              bool type_allowed, const char* name) {
        if (!accessor.fault.empty()) return refuse("needs " + accessor.fault);
        if (!type_allowed || !accessor.scalar_or_vector) {
            return refuse(fmt::format("has a {} of the wrong type", name));
        }
        if (accessor.count != position.count) {
            return refuse(fmt::format("has {} vertices but {} elements of {}", position.count,
                                      accessor.count, name));
        }
        const bool all = vertices.empty() || accessor.sparse_count != 0;
        const std::uint64_t count = all ? accessor.count : vertices.size();
        if (auto done = budget_.take_bytes(count * accessor.width * 4); !done)
            return error_of(done);
        auto values = read_floats(accessor, vertices);
        if (!values) return blame(where_, values.error());
        return values;
    }

    /// True for floats, and for the 8- and 16-bit integers that KHR_mesh_quantization allows
    /// instead.
    [[nodiscard]] bool is_float_or_quantized(const Accessor& accessor) const {
        return accessor.component == Component::f32 ||
               (model_.quantized && accessor.component != Component::u32);
    }

    Result<void> read_positions(const Deformed& deformed, GeometryDescription& geometry) {
        const Accessor& position = model_.accessors[deformed.primitive.position];
        auto values = deformed.read(
            position, position.width == 3 && is_float_or_quantized(position), "POSITION");
        if (!values) return error_of(values);
        if (deformed.motion != nullptr) deformed.motion->set_positions(*values);
        if (auto done = deformer_.morph(deformed, morphed_position, 3, *values); !done) return done;
        for (std::size_t i = 0; i + 2 < values->size(); i += 3)
            geometry.positions.emplace_back((*values)[i], (*values)[i + 1], (*values)[i + 2]);
        return {};
    }

    [[nodiscard]] Result<void> check_positions(const GeometryDescription& geometry) const {
        const auto bad =
            std::count_if(geometry.positions.begin(), geometry.positions.end(), [](const Vec3& p) {
                return !(std::abs(p.x) <= coordinate_max && std::abs(p.y) <= coordinate_max &&
                         std::abs(p.z) <= coordinate_max);
            });
        if (bad == 0) return {};
        return refuse(fmt::format("has {} {} not finite or lie{} beyond 1e15", bad,
                                  bad == 1 ? "vertex that is" : "vertices that are",
                                  bad == 1 ? "s" : ""));
    }

    Result<void> read_texcoords(const Deformed& deformed, std::size_t set, std::vector<Vec2>& out) {
        const std::uint32_t index = deformed.primitive.texcoords[set];
        if (index == no_id) return {};
        const Accessor& accessor = model_.accessors[index];
        const std::uint64_t count = model_.accessors[deformed.primitive.position].count;
        if (accessor.fault.empty() && accessor.count != count) {
            leave_out_texcoords(
                set, fmt::format("is for {} of {}", counted(accessor.count, "vertex", "vertices"),
                                 count));
            return {};
        }
        const bool normalized_unsigned =
            accessor.normalized &&
            (accessor.component == Component::u8 || accessor.component == Component::u16);
        auto values = deformed.read(
            accessor,
            accessor.width == 2 && (normalized_unsigned || is_float_or_quantized(accessor)),
            "TEXCOORD");
        if (!values) return error_of(values);
        const Morphed attribute = set == 0 ? morphed_texcoord_0 : morphed_texcoord_1;
        if (auto done = deformer_.morph(deformed, attribute, 2, *values); !done) return done;
        out.resize(values->size() / 2);
        std::uint64_t bad = 0;
        for (std::size_t i = 0; i < out.size(); ++i) {
            out[i] = {(*values)[2 * i], (*values)[2 * i + 1]};
            bad += std::isfinite(out[i].x) && std::isfinite(out[i].y) ? 0U : 1U;
        }
        if (bad == 0) return {};
        out.clear();
        leave_out_texcoords(set,
                            fmt::format("is not finite at {}", counted(bad, "vertex", "vertices")));
        return {};
    }

    void leave_out_texcoords(std::size_t set, const std::string& why) {
        leave_out(scene_, "texture_coordinate_sets",
                  fmt::format("{}: its TEXCOORD_{} {}; it is left out there", where_, set, why));
    }

    Result<void> read_colours(const Deformed& deformed, GeometryDescription& geometry) {
        const std::uint32_t index = deformed.primitive.colour;
        if (index == no_id) return {};
        const Accessor& accessor = model_.accessors[index];
        const bool type = accessor.component == Component::f32 ||
                          (accessor.normalized && (accessor.component == Component::u8 ||
                                                   accessor.component == Component::u16));
        auto values = deformed.read(accessor, type && (accessor.width == 3 || accessor.width == 4),
                                    "COLOR_0");
        if (!values) return error_of(values);
        if (auto done = deformer_.morph(deformed, morphed_colour, accessor.width, *values); !done) {
            return done;
        }
        const std::size_t count = values->size() / accessor.width;
        geometry.colours.assign(count * 4, 255);
        for (std::size_t i = 0; i < count; ++i) {
            for (std::size_t c = 0; c < accessor.width; ++c) {
                const float value = (*values)[i * accessor.width + c];
                // The comparison is false for NaN, which becomes 0.
                const float clamped = value > 0 ? std::min(value, 1.0F) : 0.0F;
                // Eight bits of linear light would show bands in the dark.
                geometry.colours[4 * i + c] =
                    c < 3 ? srgb_byte(clamped)
                          : static_cast<std::uint8_t>(std::lround(clamped * 255.0F));
            }
        }
        return {};
    }

    /// Reads normals and tangents, and morphs them. They matter to shading alone, so those that
    /// cannot be read are left out.
    Result<void> read_normals(const Deformed& deformed, GeometryDescription& geometry) {
        const std::uint32_t normal = deformed.primitive.normal;
        if (normal == no_id || geometry.indices.empty()) return {};
        auto values = read_shading(deformed, normal, 3, "NORMAL");
        if (!values) return error_of(values);
        if (deformed.motion != nullptr && !values->empty()) deformed.motion->set_normals(*values);
        const auto bends = morph_shading(deformed, morphed_normal, values->size() / 3);
        if (!bends) return error_of(bends);
        for (std::size_t i = 0; i + 2 < values->size(); i += 3) {
            const Vec3 n((*values)[i], (*values)[i + 1], (*values)[i + 2]);
            geometry.normals.push_back(bends->empty() ? n : bent(n, bends->data() + i));
        }
        if (geometry.normals.empty() || deformed.primitive.tangent == no_id) return {};
        if (geometry.material == no_id ||
            !needs_tangents(model_.materials[geometry.material].surface))
            return {};
        auto tangents = read_shading(deformed, deformed.primitive.tangent, 4, "TANGENT");
        if (!tangents) return error_of(tangents);
        if (deformed.motion != nullptr && !tangents->empty())
            deformed.motion->set_tangents(*tangents);
        const auto turns = morph_shading(deformed, morphed_tangent, tangents->size() / 4);
        if (!turns) return error_of(turns);
        for (std::size_t i = 0; i + 3 < tangents->size(); i += 4) {
            const Vec3 t((*tangents)[i], (*tangents)[i + 1], (*tangents)[i + 2]);
            geometry.tangents.emplace_back(turns->empty() ? t : bent(t, turns->data() + i / 4 * 3),
                                           (*tangents)[i + 3]);
        }
        return {};
    }

    /// Returns three differences per vertex; nothing where no target has them, and, with a warning,
    /// where one cannot be read.
    Result<std::vector<float>> morph_shading(const Deformed& deformed, Morphed attribute,
                                             std::size_t vertices) {
        std::vector<float> differences;
        bool is_morphed = false;
        for (const MorphTarget& target : deformed.primitive.targets) {
            if (target[attribute] == no_id || vertices == 0) continue;
            is_morphed = true;
            if (fits(deformed, target[attribute], 3)) continue;
            leave_out(scene_, "normals",
                      fmt::format("{} has a morph target with a {} that cannot be read; those of "
                                  "its targets are left out",
                                  where_, morphed_names[attribute]));
            return differences;
        }
        if (!is_morphed) return differences;
        if (auto done = budget_.take_bytes(vertices * 12); !done) return error_of(done);
        differences.resize(vertices * 3);
        if (auto done = deformer_.morph(deformed, attribute, 3, differences); !done)
            return error_of(done);
        return differences;
    }

    [[nodiscard]] bool fits(const Deformed& deformed, std::uint32_t index,
                            std::uint32_t width) const {
        const Accessor& accessor = model_.accessors[index];
        return accessor.fault.empty() && accessor.width == width && accessor.scalar_or_vector &&
               is_float_or_quantized(accessor) &&
               accessor.count == model_.accessors[deformed.primitive.position].count;
    }

    /// Returns nothing, with a warning, where the accessor does not fit.
    Result<std::vector<float>> read_shading(const Deformed& deformed, std::uint32_t index,
                                            std::uint32_t width, const char* name) {
        if (fits(deformed, index, width)) return deformed.read(model_.accessors[index], true, name);
        leave_out(scene_, "normals",
                  fmt::format("{} has a {} that cannot be read; it is left out", where_, name));
        return std::vector<float>{};
    }

    const Model& model_;
    const ImportLimits& limits_;
    MotionWriter& motion_;
    SceneDescription& scene_;
    Budget budget_;
    Deformer deformer_;
    Facing facing_;
    std::string where_;
};

}  // namespace

Result<std::vector<ObjectDescription>> read_meshes(const Model& model,
                                                   const std::vector<bool>& used,
                                                   const ImportLimits& limits, MotionWriter& motion,
                                                   SceneDescription& scene) {
    MeshReader reader(model, limits, motion, scene);
    std::vector<ObjectDescription> objects(model.meshes.size());
    for (std::size_t i = 0; i < model.meshes.size(); ++i) {
        if (!used[i]) continue;
        auto object = reader.read(i);
        if (!object) return error_of(object);
        objects[i] = std::move(*object);
    }
    reader.warn_of_normals();
    return objects;
}

}  // namespace raynest::gltf
