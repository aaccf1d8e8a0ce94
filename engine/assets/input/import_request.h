// The request of an import, and its limits.
#pragma once

#include "engine/bvh/build.h"
#include "engine/scene/description.h"

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace raynest {

/// A file under the name by which the main file refers to it ("textures/leaf.png",
/// percent-decoded).
struct NamedBytes {
    std::string name;
    std::span<const std::byte> bytes;
};

/// How to read a format that says neither its unit nor its axes (formats/formats.h).
struct FileOptions {
    double unit = 0;           ///< metres per unit; 0: 1
    double radius = 0;         ///< for points without one, in units of the file; 0: none
    double spacing = 0;        ///< units between the heights of a grid; 0: 1
    bool z_up = false;         ///< z points up in the file, and so in the scene; else y does
    bool auto_origin = false;  ///< an origin is chosen if the file lies far from zero
    friend bool operator==(const FileOptions&, const FileOptions&) = default;
};

struct ImportRequest {
    std::string source;             ///< "forest.glb", "builtin:forest?trees=100", "points.npy"
    std::vector<NamedBytes> files;  ///< files[0] is the main file; empty for built-in scenes
    std::string primitive;          ///< record type of a .npy, e.g. "sphere"
    BuildQuality build = BuildQuality::medium;
    WorldPoint origin{};  ///< subtracted from world coordinates before they are rounded
    /// The coordinates of the file are less this already; then `origin` is zero. For parts of
    /// compositions alone.
    WorldPoint stands_at{};
    FileOptions options{};
    std::vector<std::string> masks;  ///< rules "GLOB=HEX" (mask_rules.h)
    std::string variant = {};        ///< a variant by KHR_materials_variants; empty: none is chosen
    /// One of several meshes in a .npz: its arrays are "MESH/vertices" and "MESH/faces". Empty: it has one.
    std::string mesh = {};
};

struct ImportLimits {
    std::uint64_t bytes_max = 8ULL << 30;        ///< address space of the child
    std::uint64_t scene_bytes_max = 8ULL << 30;  ///< size of the built scene
    /// Wall time of the child, and its processor time per core.
    std::chrono::seconds time_max{120};
    std::uint64_t file_bytes_max = 1ULL << 30;
    std::uint64_t json_bytes_max = 64ULL << 20;
    std::uint32_t json_depth_max = 64;
    std::uint64_t triangles_max = 200'000'000;
    std::uint64_t instances_max = 50'000'000;
    std::uint32_t nodes_max = 4'000'000;
    std::uint32_t image_side_max = 16384;
    std::uint64_t image_bytes_max = 256ULL << 20;  ///< decoded; 4x for all images of a file
};

}  // namespace raynest
