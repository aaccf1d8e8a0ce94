// World coordinates on one side, float32 less the scene's origin on the other.
#pragma once

#include "client/connection.h"
#include "client/options.h"

#include <cstdint>
#include <string>

namespace raynest::client {

/// What a scene's name means now.
struct SceneOrigin {
    WorldPoint point{};
    std::uint64_t epoch = 0;
    WorldPoint centre{};  ///< of the scene's box, in the world
    double size = 0;      ///< the diagonal of that box; 0 for an empty scene
};
Result<SceneOrigin> ask_origin(Connection& connection, const std::string& scene);

/// A point as it travels; what float32 cannot hold becomes infinite.
[[nodiscard]] wire::Vec3 less_origin(const WorldPoint& point, const WorldPoint& origin);

/// The origin that SCENE_INFO or STARTED tells.
template <class Message>
[[nodiscard]] WorldPoint origin_of(const Message& message) {
    return {message.origin_x(), message.origin_y(), message.origin_z()};
}

/// A failure unless the scene that answers has the origin that was subtracted.
Result<void> check_origin(const WorldPoint& subtracted, const WorldPoint& answers);

}  // namespace raynest::client
