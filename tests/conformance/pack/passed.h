// An intersector with outputs and tables: counts the surfaces that a ray passes, and some stop it.
#pragma once
#include "engine/intersectors/interface.h"

#include <algorithm>
#include <tuple>

namespace raynest {

struct Passed {
    static constexpr const char* text = "counts surfaces that a ray passes";

    struct Params {
        Table stops;
        Table weights;
    };
    static constexpr auto params =
        std::tuple{param("stops", &Params::stops, 0.0F, 16777216.0F, "primitives that stop a ray"),
                   param("weights", &Params::weights, 0.0F, 1.0F,
                         "weight of the first surface, the second, ...")};

    struct Outputs {
        std::uint32_t passed = 0;
        float weight = 0;
    };
    static constexpr auto outputs =
        std::tuple{output("passed", &Outputs::passed, "surfaces that the ray passed"),
                   output("weight", &Outputs::weight, "sum of their weights, in any order")};
    Outputs* state = nullptr;

    Passed(const SceneView& /*scene*/, const Params& values)
        : stops(values.stops),
          weights(values.weights) {}

    auto operator()(const auto& ray, const PrimitiveLike auto& primitive) {
        auto hits = intersect(ray, primitive);
        hits.keep_if([&](const Surface& surface) {
            if (std::find(stops.begin(), stops.end(), static_cast<float>(surface.prim)) !=
                stops.end())
                return true;
            Outputs& own = state[ray.id];
            if (own.passed < weights.count) own.weight += weights[own.passed];
            ++own.passed;
            return false;
        });
        return hits;
    }

    Table stops, weights;
};

}  // namespace raynest
