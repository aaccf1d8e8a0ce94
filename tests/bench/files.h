// The benchmark's own file formats, little-endian and packed:
//
//   .soup  u32 triangles | per triangle 9 f32: v0 v1 v2
//   .inst  u32 0x53494e52 "RNIS" | u32 meshes, groups, root group
//          | per mesh: u32 triangles, 9 f32 each
//          | per group: u32 instances, each u32 kind (0 mesh, 1 group), u32 child, 12 f32 row-major
//   .rays  u32 rays | per ray 8 f32: ox oy oz tmin dx dy dz tmax (1e30: unbounded)
//   .ref   u32 rays | per ray f32 t (+inf: miss), u32 prim, u32 inst (of the root; else 0xffffffff)
//
// A file is used only if its size fits exactly and every index, number and transform in it is
// sound. That groups form no cycle is checked where every scene's graph is: Snapshot::build.
#pragma once

#include "engine/geometry/ray.h"
#include "engine/result.h"
#include "engine/scene/description.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace raynest::bench {

struct Reference {
    float t;
    std::uint32_t prim;
    std::uint32_t inst;
};

Result<std::vector<std::byte>> read_file(const std::string& path);
Result<SceneDescription> read_soup(const std::string& path);
/// Meshes become objects 0..m-1, groups the objects behind them.
Result<SceneDescription> read_instances(const std::string& path);
Result<std::vector<Ray>> read_rays(const std::string& path);
Result<std::vector<Reference>> read_references(const std::string& path);

}  // namespace raynest::bench
