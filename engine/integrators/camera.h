// Cameras: those of glTF, look-at, and the one that frames a scene.
#pragma once

#include "engine/math/vec.h"
#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <numbers>
#include <optional>
#include <string>

namespace raynest {

/// Looks along -Z of `to_world`, +Y up.
struct Camera {
    Transform to_world;
    float yfov = 0.7F;  ///< perspective: radians, vertical
    std::string name;
    float ymag = 0;    ///< orthographic: half of the height that it shows at least; else 0
    float aspect = 0;  ///< width over height of what an orthographic camera shows at least; 0: any
};

struct CameraRequest {
    std::string name = {};  ///< a name, or a number as digits alone; "" = the first one
    bool look_at = false;
    Vec3 eye{0}, at{0};
    std::optional<Vec3> up = {};  ///< nothing: the scene's
    float fov_degrees = 0;        ///< vertical; 0 = the camera's own, 40 for look-at
};

inline constexpr double degree = std::numbers::pi / 180;

/// A look-at of 40 degrees that has a bounding box whole in any picture at least as wide as high,
/// seen from (+x, +y, +z), with +y up, or from (+x, -y, +z) with +z up: from the south-east.
struct Framing {
    glm::dvec3 eye, at;
};
[[nodiscard]] Framing framing(const Box& bounds, UpAxis up);

/// The requested camera; scene_invalid naming the cameras there are. Without any in the file: one
/// of framing(), named "automatic".
Result<Camera> choose_camera(const Snapshot& scene, const CameraRequest& request);

}  // namespace raynest
