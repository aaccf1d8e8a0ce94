// Cameras of the built-in scenes.
#pragma once

#include "engine/scene/description.h"

namespace raynest {

/// Returns a camera for pictures of 16:9 that looks from `eye` at a point, upright. `yfov` in
/// radians.
inline CameraDescription look_at(const char* name, const Vec3& eye, const Vec3& at, float yfov) {
    const Vec3 z = glm::normalize(eye - at);
    const Vec3 x = glm::normalize(glm::cross(Vec3(0, 1, 0), z));
    const Vec3 y = glm::cross(z, x);
    CameraDescription camera;
    camera.name = name;
    camera.to_world.m = {x.x, y.x, z.x, eye.x, x.y, y.y, z.y, eye.y, x.z, y.z, z.z, eye.z};
    camera.yfov = yfov;
    camera.aspect = 16.0F / 9;
    return camera;
}

}  // namespace raynest
