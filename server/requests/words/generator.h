// The rays of a query: cameras, and generators, whose kind (generators.def) and settings become a
// sensor.
#pragma once

#include "engine/integrators/camera.h"
#include "protocol/wire.h"
#include "server/ground/errors.h"
#include "server/jobs/ray_source.h"

#include <variant>

namespace raynest::server {

/// Converts a request's camera: a camera of the scene, or a look-at.
[[nodiscard]] CameraRequest camera_request(const wire::Camera* camera);

/// A sensor with all of its rays, or a hemisphere, which makes rays from points that the client
/// sends.
using Generated = std::variant<SensorPointer, Hemisphere>;

/// Makes a generator. Fails with INVALID_FIELD or LIMIT_EXCEEDED, and names the setting that is
/// wrong, missing or not allowed for its kind.
Reply<Generated> generate(const wire::Generator& message, const Snapshot& scene);

/// True if a generator says that the scene moves while it is measured.
[[nodiscard]] bool moves_scene(const wire::Generator* generator);

/// Returns the source of a query's rays: sent by the client, or made by its generator. Fails as
/// generate() does, and where the request has rays or points that its generator does not take.
Reply<RaySource> read_rays(const wire::Query& query, const Snapshot& scene);

}  // namespace raynest::server
