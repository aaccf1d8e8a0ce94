// A scene just before it is written to an arena: records with their final offsets, and the sources
// of the bulk sections. It copies no bulk data; the description must outlive it.
#pragma once

#include "engine/bvh/build.h"
#include "engine/scene/description.h"
#include "engine/scene/format.h"
#include "engine/scene/snapshot.h"

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

namespace raynest {

/// Zero-terminated strings, each stored once; offset 0 is the empty string.
class NameTable {
public:
    /// Adds a name, up to its first zero byte, and returns its offset.
    std::uint32_t add(const std::string& name);
    [[nodiscard]] const std::string& bytes() const { return bytes_; }

private:
    std::string bytes_ = std::string(1, '\0');
    std::unordered_map<std::string, std::uint32_t> offsets_{{"", 0}};
};

/// Allocates space in the `attributes` section now and fills it later.
class AttributePlan {
public:
    /// Returns the offset of a copy of `data`, or no_offset if it is empty.
    template <class T>
    std::uint64_t add(const std::vector<T>& data) {
        return add(std::as_bytes(std::span(data)));
    }
    std::uint64_t add(std::span<const std::byte> data) {
        return place({data.data(), data.size(), 1});
    }
    /// Returns the offset of a copy of every fourth byte of `rgba`, from the fourth on.
    std::uint64_t add_alpha(std::span<const std::uint8_t> rgba);
    /// Returns the offset of zeros on separate cache lines, for write_trees; no_offset for 0 bytes.
    std::uint64_t reserve(std::uint64_t bytes);

    [[nodiscard]] std::uint64_t size() const { return size_; }
    void write(std::byte* section) const;

private:
    struct Source {
        const std::byte* first;
        std::uint64_t bytes;   ///< to write
        std::uint32_t stride;  ///< in the source
        std::uint64_t offset = 0;
    };
    std::uint64_t place(Source source);

    std::vector<Source> sources_;
    std::uint64_t size_ = 0;
};

struct Content {
    BuildQuality build = BuildQuality::medium;
    UpAxis up = UpAxis::y;
    std::uint8_t chosen_variant = 0;  ///< as in format::Header, as is the next one
    std::uint16_t variants = 0;
    WorldPoint origin{};
    std::uint64_t degenerate_triangles = 0;
    Box bounds;                                     ///< format::Header::bounds
    std::vector<const ObjectDescription*> sources;  ///< one per object
    std::vector<Tree> trees;                        ///< one per object
    std::vector<ObjectRecord> objects;
    std::vector<InstanceRecord> instances;
    std::vector<InstanceInfo> instance_infos;
    std::vector<double> instance_paddings;  ///< PlacedBox::padding, one per instance
    std::vector<GeometryRecord> geometries;
    std::vector<MaterialRecord> materials;
    std::vector<TextureRecord> textures;
    std::vector<CameraRecord> cameras;
    std::vector<SurfaceRecord> surfaces;            ///< one per material
    std::vector<GeometryShading> geometry_shading;  ///< one per geometry
    std::vector<TextureLevels> texture_levels;      ///< one per texture
    std::vector<LightRecord> lights;
    std::vector<std::byte> motion;  ///< motion/motion.h
    std::vector<format::SkipRecord> skips;
    std::vector<format::NameOffset> warnings;
    std::vector<format::NameOffset> record_types;
    std::vector<PathNode> path_nodes;
    std::vector<PathRun> path_runs;
    std::vector<std::uint32_t> instance_numbers;  ///< PathTable::numbers
    NameTable names;
    AttributePlan attributes;
    std::deque<std::vector<std::uint8_t>> opacities;  ///< per geometry; attributes point into them
    /// Copies of pictures; attributes point into them
    std::deque<std::vector<std::uint8_t>> smaller;
};

/// Adds materials, textures, lights and cameras. An image is stored once, however many textures use
/// it, and so are its smaller copies for colours and those for data.
void add_surfaces(const SceneDescription& description, Content& content);
void add_lights(const SceneDescription& description, Content& content);
void add_cameras(const SceneDescription& description, Content& content);

/// Lays out the arena and fills all of it but the trees, of which it needs the sizes in `objects`
/// alone. Throws std::bad_alloc.
Arena write_arena(const Content& content);

/// Boxes and corners of an object's triangles, for build_tree(). The description must outlive what
/// makes boxes of it.
std::function<void(std::uint32_t, std::span<Box>)> triangle_boxes(const ObjectDescription& source);
PageVector<Corners> triangle_corners(const ObjectDescription& source);

/// Fills the leaf blocks of one object, which hold zeros, from its vertices, and `texcoords` unless it is
/// null.
void write_blocks(const ObjectDescription& object, const Tree& tree,
                  std::span<const GeometryRecord> geometries, const MaterialRecord* materials,
                  TriangleBlock* blocks, TexcoordBlock* texcoords);

/// Writes nodes, leaf blocks with their texture coordinates, and records.
void write_trees(const Content& content, Arena& arena);

}  // namespace raynest
