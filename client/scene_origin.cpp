#include "client/scene_origin.h"

#include "protocol/control.h"

namespace raynest::client {

Result<SceneOrigin> ask_origin(Connection& connection, const std::string& scene) {
    wire::InfoT request;
    request.scene = scene;
    const auto info = ask<wire::SceneInfo>(connection, request);
    if (!info) return tl::unexpected<Failure>(info.error());
    return SceneOrigin{origin_of(*info->message.table), (*info)->epoch()};
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
