// The words of a RENDER, read once.
#pragma once

#include "engine/integrators/camera.h"
#include "protocol/wire.h"
#include "server/requests/words/job_words.h"
#include "server/requests/words/picture_request.h"

#include <cstdint>
#include <string_view>

namespace raynest::server {

/// The words that are views lie in the message.
struct RenderWords {
    JobWords job;
    CameraRequest camera;
    AskedPixels pixels;
    std::string_view integrator;  ///< primary where it is not given
    std::uint32_t samples = 1;
    std::uint64_t seed = 0;
    std::string_view encode;  ///< png where it is not given
#define RAYNEST_INTEGRATOR_SETTING(name, type, ...) type name = 0;
#include "engine/integrators/integrator_settings.def"
    std::string_view environment;  ///< auto where it is not given
    bool sun = false;              ///< the two angles count
    float sun_azimuth = 0;
    float sun_elevation = 0;
    std::string_view tonemap;   ///< empty where it is not given
    std::string_view exposure;  ///< empty where it is not given
    std::uint32_t best_by_ms = 0;
    bool progressive = false;
    float noise = 0;
    std::uint64_t resume_bytes = 0;
    std::uint64_t environment_bytes = 0;
    float environment_rotate = 0;
};

[[nodiscard]] RenderWords render_words(const wire::Render& message);

}  // namespace raynest::server
