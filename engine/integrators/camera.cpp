#include "engine/integrators/camera.h"

#include "engine/geometry/hit.h"
#include "engine/math/finite.h"
#include "engine/scene/camera_pose.h"

#include <algorithm>
#include <charconv>
#include <cmath>

namespace raynest {
namespace {

constexpr double default_fov = 40 * degree;

/// A pose that looks along `forward` from `eye`, +Y as close to `up` as it can be.
Transform look(const glm::dvec3& eye, const glm::dvec3& forward, glm::dvec3 up) {
    const glm::dvec3 z = -glm::normalize(forward);
    // Straight along `up` any roll would do: take the one that has north on top, which is -Z, or
    // +Y where +Z is up.
    for (const glm::dvec3 other : {glm::dvec3(0, 0, -1), glm::dvec3(0, 1, 0)}) {
        if (glm::length(glm::cross(up, z)) > 1e-6 * glm::length(up)) break;
        up = other;
    }
    const glm::dvec3 x = glm::normalize(glm::cross(up, z));
    const glm::dvec3 y = glm::cross(z, x);
    return pose_of(x, y, z, eye);
}

/// "automatic": as framing() says, looking along the diagonal exactly.
Camera framing_camera(const Box& bounds, UpAxis up) {
    const Framing view = framing(bounds, up);
    return {look(view.eye, from_y_up(up, glm::dvec3(-1)), upwards(up)),
            static_cast<float>(default_fov), "automatic"};
}

std::string camera_list(const Snapshot& scene) {
    std::string list;
    for (std::size_t i = 0; i < scene.statistics().cameras.size(); ++i) {
        list +=
            (i == 0 ? "" : ", ") + std::to_string(i) + " '" + scene.statistics().cameras[i] + "'";
    }
    return list;
}

/// Returns the index of a camera by its name, or by its number, which is digits alone.
Result<std::uint32_t> find_camera(const Snapshot& scene, const std::string& request) {
    const std::vector<std::string>& names = scene.statistics().cameras;
    if (names.empty())
        return fail(ErrorCode::scene_invalid,
                    "the scene has no cameras: use `look_at`, or name none");
    const auto refuse = [&](const std::string& why) {
        return fail(ErrorCode::scene_invalid, why + "; there are: " + camera_list(scene));
    };
    if (request.find_first_not_of("0123456789") == std::string::npos) {
        std::uint32_t index = 0;
        const char* const end = request.data() + request.size();
        const bool fits = std::from_chars(request.data(), end, index).ec == std::errc{};
        if (fits && index < names.size()) return index;
        return refuse("there is no camera " + request);
    }
    const auto named = std::find(names.begin(), names.end(), request);
    if (named == names.end()) return refuse("there is no camera '" + request + "'");
    if (std::find(named + 1, names.end(), request) != names.end())
        return refuse("several cameras are called '" + request + "': give the number");
    return static_cast<std::uint32_t>(named - names.begin());
}

Result<Camera> camera_of_request(const Snapshot& scene, const CameraRequest& request) {
    if (request.look_at) {
        const Vec3 up = request.up.value_or(Vec3(upwards(scene.up())));
        if (!is_finite(request.eye) || !is_finite(request.at) || !is_finite(up) ||
            request.eye == request.at || up == Vec3(0)) {
            return fail(
                ErrorCode::param_invalid,
                "`look_at` needs finite numbers, two different points and an up that is not 0");
        }
        return Camera{look(glm::dvec3(request.eye),
                           glm::dvec3(request.at) - glm::dvec3(request.eye), glm::dvec3(up)),
                      static_cast<float>(default_fov), "look-at"};
    }
    const SceneView& view = scene.view();
    if (request.name.empty() && view.camera_count == 0)
        return framing_camera(scene.framed_bounds(), scene.up());
    const auto index =
        request.name.empty() ? Result<std::uint32_t>(0U) : find_camera(scene, request.name);
    if (!index) return tl::unexpected(index.error());
    const CameraRecord& record = view.cameras[*index];
    return Camera{record.to_world, record.yfov, scene.statistics().cameras[*index], record.ymag,
                  record.aspect};
}

}  // namespace

Framing framing(const Box& bounds, UpAxis up) {
    constexpr double margin = 1.05;
    const bool empty = bounds.is_empty();
    const glm::dvec3 lower = empty ? glm::dvec3(-1) : glm::dvec3(bounds.lower);
    const glm::dvec3 upper = empty ? glm::dvec3(1) : glm::dvec3(bounds.upper);
    const glm::dvec3 center = 0.5 * (lower + upper);
    const glm::dvec3 backward = from_y_up(up, glm::normalize(glm::dvec3(1)));
    const glm::dvec3 right = glm::normalize(glm::cross(upwards(up), backward));
    const glm::dvec3 top = glm::cross(backward, right);

    // Each corner asks for a distance at which it appears on the edge of the picture.
    const double tangent = std::tan(default_fov / 2);
    double distance = 0;
    for (unsigned corner = 0; corner < 8; ++corner) {
        const glm::dvec3 p =
            glm::dvec3((corner & 1) != 0 ? upper.x : lower.x, (corner & 2) != 0 ? upper.y : lower.y,
                       (corner & 4) != 0 ? upper.z : lower.z) -
            center;
        const double aside = std::max(std::abs(glm::dot(p, right)), std::abs(glm::dot(p, top)));
        distance = std::max(distance, margin * aside / tangent + glm::dot(p, backward));
    }
    if (distance == 0) distance = std::max(1.0, 1e-3 * glm::length(center));  // a single point
    return {center + distance * backward, center};
}

Result<Camera> choose_camera(const Snapshot& scene, const CameraRequest& request) {
    const float fov = request.fov_degrees;
    if (fov != 0 && !(fov > 0 && fov < 180)) {
        return fail(ErrorCode::param_invalid,
                    "the field of view must lie between 0 and 180 degrees");
    }
    auto camera = camera_of_request(scene, request);
    if (camera && fov != 0 && camera->ymag != 0) {
        return fail(ErrorCode::param_invalid,
                    "camera '" + camera->name + "' is orthographic: it has no field of view");
    }
    if (camera && fov != 0) camera->yfov = static_cast<float>(static_cast<double>(fov) * degree);
    return camera;
}

}  // namespace raynest
