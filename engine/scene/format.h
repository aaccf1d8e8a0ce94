// The arena's layout in memory and on disk; FORMAT.md draws it.
//
// A header with a table of sections, then the sections one behind the other, each aligned to 64
// bytes: there is exactly one way to lay out a given content, so equal scenes have equal bytes.
#pragma once

#include "engine/bvh/build.h"
#include "engine/bvh/node.h"
#include "engine/geometry/path.h"
#include "engine/geometry/triangle.h"
#include "engine/geometry/up_axis.h"
#include "engine/geometry/views.h"
#include "engine/shading/records.h"

#include <array>
#include <cstddef>
#include <cstdint>

namespace raynest::format {

/// A reason for which parts of the source are not in the scene, and their number.
struct SkipRecord {
    std::uint64_t count;
    std::uint32_t reason;  ///< offset in `names`
    std::uint32_t unused;
};

/// Offset in `names` of a warning or of the name of a primitive type.
using NameOffset = std::uint32_t;

enum class Section : std::uint32_t {
    nodes,
    blocks,
    records,
    objects,
    instances,
    instance_infos,
    geometries,
    materials,
    textures,
    cameras,
    attributes,
    names,
    skips,
    warnings,
    record_types,
    path_nodes,
    path_runs,
    instance_numbers,
    surfaces,
    geometry_shading,
    texture_levels,
    lights,
    motion,
    count_
};
inline constexpr std::size_t section_count = static_cast<std::size_t>(Section::count_);

/// Bytes of one element, in the order of Section. A change of any record changes this table, and an
/// arena of another build is refused instead of misread.
inline constexpr std::array<std::uint32_t, section_count> element_size{
    sizeof(Node),
    sizeof(TriangleBlock),
    1,
    sizeof(ObjectRecord),
    sizeof(InstanceRecord),
    sizeof(InstanceInfo),
    sizeof(GeometryRecord),
    sizeof(MaterialRecord),
    sizeof(TextureRecord),
    sizeof(CameraRecord),
    1,
    1,
    sizeof(SkipRecord),
    sizeof(NameOffset),
    sizeof(NameOffset),
    sizeof(PathNode),
    sizeof(PathRun),
    sizeof(std::uint32_t),
    sizeof(SurfaceRecord),
    sizeof(GeometryShading),
    sizeof(TextureLevels),
    sizeof(LightRecord),
    1,
};
// No record has padding: its bytes are its content, so the digest is well defined. Those of shading
// (records.h) and of trees say so themselves.
static_assert(sizeof(ObjectRecord) == 120 && sizeof(InstanceInfo) == 60);
static_assert(sizeof(GeometryRecord) == 64 && sizeof(MaterialRecord) == 64);
static_assert(sizeof(TextureRecord) == 40 && sizeof(CameraRecord) == 64);
static_assert(sizeof(GeometryShading) == 16 && sizeof(TextureLevels) == 16);
static_assert(sizeof(SkipRecord) == 16 && sizeof(PathNode) == 20 && sizeof(PathRun) == 16);

struct SectionEntry {
    std::uint64_t offset;  ///< from the start of the arena
    std::uint64_t count;   ///< elements
    std::uint32_t element_size;
    std::uint32_t unused;
};

inline constexpr std::array<char, 8> magic{'R', 'N', 'S', 'C', 'E', 'N', 'E', '\0'};
inline constexpr std::uint32_t version = 15;
inline constexpr std::uint32_t byte_order = 0x01020304;
inline constexpr std::uint64_t alignment = 64;

struct Header {
    std::array<char, 8> magic;
    std::uint32_t version;
    std::uint32_t byte_order;  ///< 0x01020304 in the reader's byte order
    std::uint64_t bytes;       ///< bytes in the whole arena
    BuildQuality build;        ///< how the trees were built
    UpAxis up;
    std::uint8_t chosen_variant;  ///< its number, from 1; 0: none
    /// So many warnings, the last ones, are names of variants.
    std::uint16_t variants;
    std::array<double, 3> origin;  ///< subtracted from world coordinates
    std::uint64_t degenerate_triangles;
    Box bounds;  ///< box of the vertices in the scene; the trees' boxes are larger
    std::array<SectionEntry, section_count> sections;
};
static_assert(sizeof(Header) == 88 + 24 * section_count);

[[nodiscard]] constexpr std::uint64_t aligned(std::uint64_t offset) {
    return (offset + alignment - 1) / alignment * alignment;
}

/// Returns the start of a section in an arena whose header was checked or has just been written.
template <class T>
[[nodiscard]] const T* section(const std::byte* arena, Section which) {
    const auto& header = *reinterpret_cast<const Header*>(arena);
    return reinterpret_cast<const T*>(arena +
                                      header.sections[static_cast<std::size_t>(which)].offset);
}

[[nodiscard]] inline std::uint64_t section_size(const std::byte* arena, Section which) {
    return reinterpret_cast<const Header*>(arena)->sections[static_cast<std::size_t>(which)].count;
}

/// Returns the path table of an arena whose header and section table were checked.
[[nodiscard]] inline PathTable path_table(const std::byte* arena) {
    PathTable table;
    table.nodes = section<PathNode>(arena, Section::path_nodes);
    table.runs = section<PathRun>(arena, Section::path_runs);
    if (section_size(arena, Section::instance_numbers) != 0)
        table.numbers = section<std::uint32_t>(arena, Section::instance_numbers);
    table.names_bytes = section_size(arena, Section::names);
    table.node_count = static_cast<std::uint32_t>(section_size(arena, Section::path_nodes));
    table.run_count = static_cast<std::uint32_t>(section_size(arena, Section::path_runs));
    return table;
}

}  // namespace raynest::format
