// The rays that are measured: five kinds, each with its own coherence and its own way to end.
#pragma once

#include "engine/geometry/ray.h"
#include "engine/math/random.h"
#include "engine/packs/abi.h"
#include "tests/bench/workload.h"

#include <cstdint>
#include <string>
#include <vector>

namespace raynest::bench {

/// primary   a camera's pixels, in 8 x 8 tiles of four 4 x 4 tiles
/// ao        one short cosine ray per primary hit; any hit
/// shadow    one ray per primary hit to a point of the scene's light (without one: to a rectangle
///           above the scene); any hit
/// diffuse   one unbounded cosine ray per primary hit
/// random    uniform origins in the scene's box, uniform directions
enum class RayKind { primary, ao, shadow, diffuse, random };
Result<RayKind> parse_ray_kind(const std::string& name);
/// Closest hit or any hit: what a renderer asks of such rays.
Query natural_query(RayKind kind);

/// About `count` rays, fewer where the scene gives fewer hits: runs of 1024 consecutive rays spread
/// evenly over a picture of 8 x count pixels, so that their coherence survives. `trace` finds the
/// primary hits; it is the opaque one, so that masked and opaque rows have the same rays.
std::vector<Ray> make_rays(const Workload& workload, RayKind kind, std::uint32_t count,
                           TraceFunction trace);

/// Makes rays of RayKind::random.
std::vector<Ray> random_rays(const Box& box, std::uint32_t count, Random& random);

}  // namespace raynest::bench
