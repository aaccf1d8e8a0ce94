// The rays of one path as the JSON document of client/EXPLAIN.md.
#pragma once

#include "engine/inspection/path_recorder.h"
#include "engine/integrators/film.h"
#include "server/execution/plan.h"

#include <array>
#include <cstdint>
#include <span>
#include <string>

namespace raynest::server {

/// Says which sample of which picture the path is.
struct PathContext {
    const protocol::Limits& limits;
    std::string camera;
    std::array<std::uint32_t, 2> pixel{};
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::string integrator;
    std::uint64_t seed = 0;
    std::uint32_t sample = 0;
};

[[nodiscard]] std::string path_json(const Plan& plan, const PathContext& context,
                                    const FilmSample& sample, std::span<const PathRay> rays);

}  // namespace raynest::server
