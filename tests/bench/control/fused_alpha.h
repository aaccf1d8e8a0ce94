// The alpha test compiled in.
#pragma once

#include "engine/intersectors/interface.h"
#include "tests/bench/control/alpha_test.h"

namespace raynest {

struct FusedAlpha {
    static constexpr const char* text = "control: the alpha test compiled in";
    struct Params {};
    static constexpr auto params = std::tuple{};
    FusedAlpha(const SceneView& view, const Params&) : scene(view) {}

    auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto hits = intersect(ray, triangle);
        hits.keep_if(
            [&](const Surface& surface) { return passes_alpha(scene, *ray.object, surface); });
        return hits;
    }

    const SceneView& scene;
};

}  // namespace raynest
