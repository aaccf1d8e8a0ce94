// What is measured: a scene and a set of rays, from files or generated.
#pragma once

#include "engine/packs/registry.h"
#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace raynest::bench {

/// A scene twice: as described (what a peer is built from) and baked.
struct Workload {
    std::string name;
    SceneDescription description;
    std::shared_ptr<const Snapshot> scene;
};

/// `builtin:...`, a glTF file, or a triangle soup (`.soup`: u32 count, 9 f32 each).
Result<Workload> load_workload(const std::string& source, const Registry& registry);

enum class RayKind { primary, ao, diffuse, random };
Result<RayKind> parse_ray_kind(const std::string& name);

/// About `count` rays. primary: a camera's pixels in 8 x 8 tiles; ao: short cosine rays from
/// primary hits; diffuse: unbounded ones; random: uniform origins in the scene's box, uniform
/// directions. `trace` is the closest-hit function that finds the primary hits.
std::vector<Ray> make_rays(const Workload& workload, RayKind kind, std::uint32_t count,
                           TraceFunction trace);

/// `.rays`: u32 count, then 8 f32 each (ox oy oz tmin dx dy dz tmax). Checks the exact file size.
Result<std::vector<Ray>> load_rays(const std::string& path);

}  // namespace raynest::bench
