#include "client/requests/scene_origin.h"

#include "protocol/control.h"

#include <cmath>

namespace raynest::client {

Result<SceneOrigin> ask_origin(Connection& connection, const std::string& scene) {
    wire::InfoT request;
    request.scene = scene;
    const auto info = ask<wire::SceneInfo>(connection, request);
    if (!info) return tl::unexpected<Failure>(info.error());
    SceneOrigin found{origin_of(*info->message.table), (*info)->epoch()};
    const auto *lower = (*info)->box_min(), *upper = (*info)->box_max();
    if (lower == nullptr || upper == nullptr || !(lower->x() <= upper->x())) return found;
    const auto middle = [](float from, float to) { return (double{from} + double{to}) / 2; };
    found.centre = {found.point[0] + middle(lower->x(), upper->x()),
                    found.point[1] + middle(lower->y(), upper->y()),
                    found.point[2] + middle(lower->z(), upper->z())};
    found.size =
        std::hypot(double{upper->x()} - double{lower->x()}, double{upper->y()} - double{lower->y()},
                   double{upper->z()} - double{lower->z()});
    return found;
}

wire::Vec3 less_origin(const WorldPoint& point, const WorldPoint& origin) {
    const auto rounded = [&](std::size_t axis) {
        return static_cast<float>(point[axis] - origin[axis]);
    };
    return {rounded(0), rounded(1), rounded(2)};
}

Result<void> check_origin(const WorldPoint& subtracted, const WorldPoint& answers) {
    if (subtracted == answers) return {};
    return fail(Exit::failed,
                "the scene has just been replaced by one with another origin; ask again");
}

}  // namespace raynest::client
