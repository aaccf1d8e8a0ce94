// The checks of intersectors/check.h at the one ray width of a GPU. An overload that is not called
// there would be a mask that only the CPU applies.
#pragma once

#include "engine/bvh/visit_primitive.h"
#include "engine/cuda/device_tree.h"
#include "engine/intersectors/declared.h"

namespace raynest::cuda {

template <class Isect, Declared declared>
constexpr bool check_intersector() {
    static_assert((Overrides<Isect, BoxRay, TriangleValue> || overrides_any_record<Isect>()) ==
                      declared.primitives,
                  "the row and the type disagree about `primitives` on CUDA; write "
                  "RAYNEST_FN auto operator()(const auto& ray, const TriangleLike auto& triangle)");
    static_assert(Overrides<Isect, BoxRay, CompressedBox> == declared.boxes,
                  "the row and the type disagree about `boxes` on CUDA; write "
                  "RAYNEST_FN auto operator()(const auto& ray, const BoxLike auto& boxes)");
    static_assert(Overrides<Isect, BoxRay, Instance> == declared.instances,
                  "the row and the type disagree about `instances` on CUDA");
    static_assert(returns_what_intersect_returns<Isect, BoxRay, TriangleValue>() &&
                      returns_what_intersect_returns<Isect, BoxRay, CompressedBox>(),
                  "an overload must return what intersect(ray, thing) returns");
    return true;
}

}  // namespace raynest::cuda
