// Another ray tracer in the same process, for ratios.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/ray.h"
#include "engine/result.h"
#include "engine/scene/description.h"

#include <memory>
#include <span>
#include <string>

namespace raynest::bench {

class Peer {
public:
    virtual ~Peer() = default;
    [[nodiscard]] virtual std::string name() const = 0;
    /// Closest hits: t (+inf on a miss) per ray.
    virtual void closest(std::span<const Ray> rays, std::span<float> t) = 0;
    /// Any hit: 0 or +inf per ray.
    virtual void any(std::span<const Ray> rays, std::span<float> t) = 0;
};

/// Embree in its best configuration (frequency_level=simd512, huge pages: else it takes a 4-wide
/// tree on some CPUs and every ratio flatters us). Debian's build knows one level of instances, so
/// deeper scenes are given as the list of their leaf placements. Fails when the build has no
/// Embree.
Result<std::unique_ptr<Peer>> make_embree(const SceneDescription& scene);

}  // namespace raynest::bench
