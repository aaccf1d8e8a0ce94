// A ray that enters a tree.
#pragma once

#include "engine/geometry/shear.h"
#include "engine/geometry/slabs.h"

namespace raynest {

/// The terms of the box and triangle tests, computed once per level.
struct BoxRay : RayView {
    Slabs slabs;
    Shear shear;

    RAYNEST_INLINE explicit BoxRay(const RayView& ray)
        : RayView{ray.origin, ray.direction, ray.tmin, ray.tmax, ray.world, ray.scene,
                  ray.object, ray.path,      ray.id,   ray.mask, ray.flags, ray.level},
          slabs(ray) {
        // Where only instances lie, only boxes are met (measured on three levels: 2 %).
        if (ray.object == nullptr || ray.object->has_own_primitives()) shear = Shear(ray);
    }
};

}  // namespace raynest
