// Traces a program's own rays: what a program does with a registry and a scene that asks for closest
// hits alone. TraceCall (abi.h) has the rest.
#pragma once

#include "engine/packs/kernel_selector.h"
#include "engine/packs/registry.h"

#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest {

/// One scene and one intersector, both of which must outlive it. Immutable once made: any number of
/// threads may trace at once.
class Tracer {
public:
    /// Fails as Registry::choose() and parse_settings() do.
    static Result<Tracer> make(const Registry& registry, const SceneView& scene,
                               std::string_view intersector = "auto",
                               std::span<const std::pair<std::string, std::string>> settings = {});

    [[nodiscard]] const Variant& variant() const { return *variant_; }
    /// Returns one hit per ray. Fails with `internal` where the kernel refuses the call, such as out
    /// of memory.
    [[nodiscard]] Result<std::vector<HitRecord>> closest_hits(std::span<const Ray> rays) const;

private:
    Tracer(const SceneView& scene, const Variant& variant, Settings settings,
           KernelSelector kernels)
        : scene_(&scene),
          variant_(&variant),
          settings_(std::move(settings)),
          kernels_(kernels) {}

    const SceneView* scene_;
    const Variant* variant_;
    Settings settings_;
    KernelSelector kernels_;
};

}  // namespace raynest
