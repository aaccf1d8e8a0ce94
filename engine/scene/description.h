// A scene as an importer or a program describes it: plain vectors, no trees yet.
//
// Snapshot::build turns it into a snapshot. Objects may hold triangles or records of one other
// primitive type, and instances of other objects beside them; the graph of instances must be
// acyclic.
#pragma once

#include "engine/bvh/build.h"
#include "engine/geometry/hit.h"
#include "engine/geometry/up_axis.h"
#include "engine/geometry/views.h"
#include "engine/math/vec.h"
#include "engine/shading/records.h"

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace raynest {

/// A point in the world, in more digits than float32 has.
using WorldPoint = std::array<double, 3>;

struct ImageDescription {
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::vector<std::uint8_t> rgba;  ///< width*height*4, sRGB colour, straight alpha, row 0 on top
};

struct TextureDescription {
    std::uint32_t image = no_id;
    Wrap wrap_s = Wrap::repeat;
    Wrap wrap_t = Wrap::repeat;
    bool nearest = false;
    bool linear = false;  ///< data; else colours in sRGB
    bool alpha = true;    ///< a material may test its alpha
};

struct MaterialDescription {
    std::string name;
    Vec4 base_colour{1.0F};
    std::uint32_t texture = no_id;
    std::uint32_t texcoord = 0;
    std::array<float, 6> uv_transform{1, 0, 0, 0, 1, 0};
    AlphaMode alpha_mode = AlphaMode::opaque;
    float cutoff = 0.5F;
    bool double_sided = false;
    SurfaceRecord surface = {};  ///< its textures index those of the scene
};

struct GeometryDescription {
    std::vector<Vec3> positions;
    std::vector<std::uint32_t> indices;  ///< three per triangle, all below positions.size()
    std::vector<Vec2> texcoords[2];      ///< empty or one per vertex
    std::vector<std::uint8_t> colours;   ///< empty or RGBA per vertex
    std::vector<Vec3> normals = {};      ///< empty or one per vertex, any length
    std::vector<Vec4> tangents = {};     ///< empty or one per vertex, with the bitangent's sign
    std::uint32_t material = no_id;

    /// Returns the texture coordinates of a triangle's corners, from a set that is not empty.
    [[nodiscard]] std::array<Vec2, 3> corner_texcoords(std::uint32_t set,
                                                       std::size_t triangle) const {
        const std::vector<Vec2>& st = texcoords[set];
        const std::uint32_t* const corner = indices.data() + 3 * triangle;
        return {st[corner[0]], st[corner[1]], st[corner[2]]};
    }
};

struct InstanceDescription {
    std::uint32_t object = no_id;
    Transform transform;  ///< to the parent's space
    std::uint32_t mask = 0xFFFFFFFFU;
    std::uint32_t uid = 0;
    std::string name;
};

struct ObjectDescription {
    std::string name;
    std::vector<GeometryDescription> geometries;
    std::vector<InstanceDescription> instances;
    /// The node of the file that placed each instance, for messages; empty if there are no nodes.
    std::vector<std::uint32_t> placed_by = {};
    std::string record_type;         ///< name of a primitive other than triangle, "" when none
    std::vector<std::byte> records;  ///< record_bounds.size() records of equal size
    std::vector<Box> record_bounds;
    std::vector<std::uint8_t> record_colours = {};  ///< empty or RGBA per record, sRGB
};

struct LightDescription {
    std::string name;
    LightRecord light;  ///< in the scene's space; `name` is set by the build
};

struct CameraDescription {
    std::string name;
    Transform to_world;
    float yfov = 0.7F;  ///< radians, vertical; 0 for an orthographic camera
    float aspect = 0;   ///< width / height; 0: the picture's
    float ymag = 0;     ///< orthographic: half of the visible height
};

/// A node of the source's tree, and the number of its own placements.
struct PathNodeDescription {
    std::uint32_t parent = 0;  ///< its index among the nodes
    std::string name;
    std::uint32_t source = 0;  ///< index in the file
    std::uint32_t placements = 0;
};

struct SceneDescription {
    std::vector<ObjectDescription> objects;
    std::uint32_t root = 0;
    /// Nodes that name the paths, if the source is a tree of nodes; its instances then need no
    /// names. Breadth first, the scene itself first. Empty: instances name the paths.
    std::vector<PathNodeDescription> path_nodes;
    /// Nodes with placements in the order of their paths, singular instances counted: depth first.
    std::vector<std::uint32_t> placed_nodes;
    /// The point that was subtracted from world coordinates; all others are relative to it.
    WorldPoint origin{};
    UpAxis up = UpAxis::y;
    /// The largest distance by which rounding to float32 moved a vertex or a placement.
    double rounding = 0;
    /// The largest distance by which float32 coordinates of the file may be off from what they were
    /// rounded from, before they came here.
    double file_rounding = 0;
    BuildQuality build = BuildQuality::medium;
    std::vector<MaterialDescription> materials;
    std::vector<TextureDescription> textures;
    std::vector<ImageDescription> images;
    std::vector<CameraDescription> cameras;
    std::vector<LightDescription> lights = {};
    std::vector<std::byte> motion = {};  ///< tables of motion/motion.h; empty: nothing moves
    /// Reason -> count, e.g. {"singular_instances", 1}; shown by `info` and `load`.
    std::map<std::string, std::uint64_t> skipped;
    std::vector<std::string> warnings;
    /// Looks of the materials that the file offers (KHR_materials_variants).
    std::vector<std::string> variants = {};
    std::size_t chosen_variant = 0;  ///< its number, from 1; 0: none
};

}  // namespace raynest
