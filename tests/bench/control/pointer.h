// A test of candidates behind a pointer, as a library with callbacks has it: the pointer is read
// once per call and asked at run time, for every block that has a candidate.
#pragma once

#include "engine/intersectors/interface.h"

namespace raynest {

/// May the surface be hit? As a callback has to take it: what it needs, behind an address.
using SurfaceTest = bool (*)(const void* context, const ObjectRecord* object,
                             const Surface& surface);

struct PointerTested {
    /// `test` is read from where the compiler cannot see its value.
    PointerTested(const SurfaceTest volatile& from, const void* user) : test(from), context(user) {}

    auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto hits = intersect(ray, triangle);
        if (test != nullptr) {
            hits.keep_if(
                [&](const Surface& surface) { return test(context, ray.object, surface); });
        }
        return hits;
    }

    SurfaceTest test;
    const void* context;
};

}  // namespace raynest
