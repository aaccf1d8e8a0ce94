// The plain views that kernels read: a scene as flat arrays, no pointers inside the records.
//
// A SceneView points into one snapshot arena (scene/snapshot.h). Every record is relocatable: an
// object names its nodes, leaf blocks and attributes by offset, so that arenas can be cached,
// mapped by a worker process, joined or sent to a GPU.
#pragma once

#include "engine/geometry/box.h"
#include "engine/geometry/hit.h"
#include "engine/math/vec.h"

#include <cstddef>
#include <cstdint>

namespace raynest {

struct Node;           // bvh/node.h
struct TriangleBlock;  // geometry/triangle.h

enum class AlphaMode : std::uint32_t { opaque, mask, blend };
enum class Wrap : std::uint32_t { repeat, clamp, mirror };

/// An image decoded once, with the sampler of one glTF texture. 8-bit planes, row 0 on top.
struct TextureRecord {
    /// Byte offset in `attributes` of width*height RGBA8 (sRGB), no alpha weight
    std::uint64_t colour;
    std::uint64_t alpha;  ///< byte offset of width*height u8: the plane that alpha tests read
    std::uint32_t width;
    std::uint32_t height;
    Wrap wrap_s;
    Wrap wrap_t;
    std::uint32_t nearest;  ///< 1: magFilter says NEAREST
    std::uint32_t unused;
};

struct MaterialRecord {
    Vec4 base_colour;       ///< linear
    float uv_transform[6];  ///< KHR_texture_transform as rows (a b c, d e f): s = a u + b v + c
    std::uint32_t texture;  ///< index, or no_id
    std::uint32_t texcoord;
    AlphaMode alpha_mode;
    float cutoff;
    std::uint32_t double_sided;
    std::uint32_t name;  ///< offset in `names`
};

/// One glTF primitive: a run of triangles that share a material. All offsets are bytes in
/// `attributes`; no_offset where the file has no such attribute.
inline constexpr std::uint64_t no_offset = ~0ULL;
struct GeometryRecord {
    std::uint64_t positions;     ///< 3 x f32 per vertex
    std::uint64_t indices;       ///< 3 x u32 per triangle
    std::uint64_t texcoords[2];  ///< 2 x f32 per vertex
    std::uint64_t colours;       ///< 4 x u8 per vertex (COLOR_0, linear)
    std::uint64_t opacity;       ///< 2 x u8 per triangle: Opacity; of masked and blended materials
    std::uint32_t first_triangle;  ///< in the object's flat numbering
    std::uint32_t triangle_count;
    std::uint32_t vertex_count;
    std::uint32_t material;  ///< index, or no_id
};

/// True if the material has a texture and the geometry has the texture coordinates for it. A
/// texture without them counts 1.
[[nodiscard]] RAYNEST_FN inline bool has_texture(const GeometryRecord& geometry,
                                                 const MaterialRecord& material) {
    return material.texture != no_id && geometry.texcoords[material.texcoord] != no_offset;
}

/// Is alpha of the geometry's triangles looked up in a texture?
[[nodiscard]] RAYNEST_FN inline bool has_alpha_texture(const GeometryRecord& geometry,
                                                       const MaterialRecord* materials) {
    if (geometry.material == no_id) return false;
    const MaterialRecord& material = materials[geometry.material];
    return material.alpha_mode != AlphaMode::opaque && has_texture(geometry, material);
}

/// The least and the largest alpha anywhere on a triangle, in 255ths and rounded outward. 0 as the
/// least and 255 as the largest say nothing: alpha may lie beyond.
struct Opacity {
    std::uint8_t least, largest;

    [[nodiscard]] RAYNEST_FN bool is_all_at_least(float alpha) const {
        return least != 0 && static_cast<float>(least) >= 255.0F * alpha;
    }
    [[nodiscard]] RAYNEST_FN bool is_all_below(float alpha) const {
        return largest != 255 && static_cast<float>(largest) < 255.0F * alpha;
    }
};

/// Texture coordinates of the eight triangles of a leaf block, for tests of alpha: a candidate
/// comes from its block, and through indices and vertices the way to them is one cache miss longer.
struct TexcoordBlock {
    Vec2 corner[8][3];  ///< [lane][corner]; 0 in lanes whose alpha is in no texture
};
static_assert(sizeof(TexcoordBlock) == 192);

/// One placement of an object in its parent. Stored in declaration order.
struct InstanceRecord {
    ColumnTransform to_object;  ///< from the parent's space
    std::uint32_t object;
    /// Skipped when (mask & request mask) == 0: the bits of InstanceInfo::mask with which rays see
    /// something inside
    std::uint32_t mask;
    std::uint64_t path_base;  ///< leaf placements of the parent before this one (geometry/path.h)
};
static_assert(sizeof(InstanceRecord) == 64);

/// The part of an instance that only names, edits and columns read; same index as InstanceRecord.
struct InstanceInfo {
    Transform to_parent;
    std::uint32_t uid;
    std::uint32_t name;  ///< offset in `names`
    std::uint32_t mask;  ///< as it was given, whatever stands inside
};

/// A BVH over triangles or records of one other primitive type, over instances, or over both kinds.
/// Never triangles and records together: a hit names either by one flat index.
struct ObjectRecord {
    Box bounds;
    /// >= 1: how much rounding of the ray the box test must absorb, see geometry/slabs.h
    float origin_error;
    std::uint32_t root;  ///< child word of the tree (bvh/node.h)
    std::uint64_t first_node;
    std::uint64_t first_block;
    std::uint64_t first_record;     ///< byte offset in `records`
    std::uint64_t placement_count;  ///< leaf placements below (geometry/path.h)
    /// Byte offset in `attributes`, one per leaf block; no_offset where no alpha is in a texture
    std::uint64_t texcoord_blocks;
    std::uint32_t node_count;
    std::uint32_t block_count;
    std::uint32_t triangle_count;
    std::uint32_t first_geometry;
    std::uint32_t geometry_count;
    std::uint32_t first_instance;
    std::uint32_t instance_count;
    std::uint32_t record_type;  ///< primitive_type("sphere") etc.; 0 when there are none
    std::uint32_t record_count;
    std::uint32_t record_size;  ///< bytes of one record, see record_stride
    std::uint32_t levels;       ///< BVHs on the longest path down, itself included
    std::uint32_t name;         ///< offset in `names`

    [[nodiscard]] RAYNEST_FN bool has_own_primitives() const {
        return triangle_count + record_count != 0;
    }
};

/// Bytes from one entry of `records` to the next: the record, zeros up to a multiple of 4, and its
/// original index as u32, because the tree reorders records. Behind an object's entries lies the
/// way back: the place of each original index, u32.
[[nodiscard]] constexpr std::uint64_t record_stride(std::uint32_t record_size) {
    return (std::uint64_t{record_size} + 3) / 4 * 4 + sizeof(std::uint32_t);
}

/// Bytes of all of an object's records, the way back included.
[[nodiscard]] constexpr std::uint64_t records_bytes(const ObjectRecord& object) {
    return object.record_count * (record_stride(object.record_size) + sizeof(std::uint32_t));
}

struct CameraRecord {
    Transform to_world;  ///< scale removed; looks along -Z, +Y up
    float yfov;          ///< radians, vertical; 0 of an orthographic camera
    float aspect;        ///< width over height, 0 when the file does not say
    std::uint32_t name;  ///< offset in `names`
    float ymag;          ///< orthographic: half of the height that it shows; else 0
};

struct SceneView {
    const Node* nodes = nullptr;
    const TriangleBlock* blocks = nullptr;
    const std::byte* records = nullptr;  ///< primitives other than triangles, in tree order
    const ObjectRecord* objects = nullptr;
    const InstanceRecord* instances = nullptr;
    const InstanceInfo* instance_infos = nullptr;
    const GeometryRecord* geometries = nullptr;
    const MaterialRecord* materials = nullptr;
    const TextureRecord* textures = nullptr;
    const CameraRecord* cameras = nullptr;
    const std::byte* attributes = nullptr;
    const char* names = nullptr;  ///< zero-terminated strings
    std::uint32_t object_count = 0;
    std::uint32_t instance_count = 0;
    std::uint32_t geometry_count = 0;
    std::uint32_t material_count = 0;
    std::uint32_t texture_count = 0;
    std::uint32_t camera_count = 0;
    std::uint32_t root = 0;               ///< index of the outermost object
    std::uint32_t masked_materials = 0;   ///< MASK or BLEND, in use or not
    std::uint32_t blended_materials = 0;  ///< those of them that are BLEND
    std::uint32_t cut_triangles = 0;      ///< 1: a tree may name a triangle in several leaves

    template <class T>
    [[nodiscard]] RAYNEST_FN const T* attribute(std::uint64_t offset) const {
        return reinterpret_cast<const T*>(attributes + offset);
    }

    /// Returns the opacity of a triangle, given by its flat index in the geometry's object.
    [[nodiscard]] RAYNEST_FN Opacity opacity_of(const GeometryRecord& geometry,
                                                std::uint32_t triangle) const {
        if (geometry.opacity == no_offset) return {0, 255};
        return attribute<Opacity>(geometry.opacity)[triangle - geometry.first_triangle];
    }

    /// A record by its original index, as hits name it.
    [[nodiscard]] const std::byte* record_of(const ObjectRecord& object,
                                             std::uint32_t original) const {
        const std::uint64_t stride = record_stride(object.record_size);
        const std::byte* entries = records + object.first_record;
        const std::byte* places = entries + object.record_count * stride;
        std::uint32_t place;
        __builtin_memcpy(&place, places + std::uint64_t{original} * sizeof place, sizeof place);
        return entries + place * stride;
    }

    /// The geometry that holds a flat triangle index of `object`; objects have few geometries.
    [[nodiscard]] RAYNEST_FN const GeometryRecord& geometry_of(const ObjectRecord& object,
                                                               std::uint32_t triangle) const {
        const GeometryRecord* first = geometries + object.first_geometry;
        std::uint32_t count = object.geometry_count;
        while (count > 1) {
            const std::uint32_t half = count / 2;
            if (first[half].first_triangle <= triangle) {
                first += half;
                count -= half;
            } else {
                count = half;
            }
        }
        return *first;
    }
};

/// Identifies a primitive type inside objects and packs: FNV-1a of its name, never 0.
[[nodiscard]] constexpr std::uint32_t primitive_type(const char* name) {
    std::uint32_t hash = 2166136261U;
    for (; *name != '\0'; ++name) hash = (hash ^ static_cast<unsigned char>(*name)) * 16777619U;
    return hash == 0 ? 1 : hash;
}

}  // namespace raynest
