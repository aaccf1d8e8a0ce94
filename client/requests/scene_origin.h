// Converts between world coordinates and float32 relative to the scene's origin.
#pragma once

#include "client/net/connection.h"
#include "client/requests/request_options.h"

#include <cstdint>
#include <string>

namespace raynest::client {

/// The scene that a name means now: its origin and epoch.
struct SceneOrigin {
    WorldPoint point{};
    std::uint64_t epoch = 0;
    WorldPoint centre{};  ///< the middle of the scene's box, in the world
    double size = 0;      ///< the diagonal of that box; 0 for an empty scene
};
Result<SceneOrigin> ask_origin(Connection& connection, const std::string& scene);

/// Returns a point in the form that is sent; values beyond float32 become infinite.
[[nodiscard]] wire::Vec3 less_origin(const WorldPoint& point, const WorldPoint& origin);

/// Returns the origin in SCENE_INFO or STARTED.
template <class Message>
[[nodiscard]] WorldPoint origin_of(const Message& message) {
    return {message.origin_x(), message.origin_y(), message.origin_z()};
}

/// Fails unless the answering scene has the origin that was subtracted.
Result<void> check_origin(const WorldPoint& subtracted, const WorldPoint& answers);

}  // namespace raynest::client
