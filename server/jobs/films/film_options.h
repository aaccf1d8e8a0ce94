// The options of a lit picture, checked.
#pragma once

#include "engine/assets/images/image.h"
#include "engine/integrators/integrator.h"
#include "engine/integrators/tonemap.h"

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

struct FilmOptions {
    std::string integrator;
    IntegratorSettings settings;
    std::uint32_t samples = 1;
    std::uint64_t seed = 0;
    Look look;
    std::uint32_t best_by_ms = 0;
    bool progressive = false;
    float noise = 0;
    std::uint64_t resume_bytes = 0;
    std::uint64_t environment_bytes = 0;
    /// Samples of each tile at the end of each pass.
    std::vector<std::uint32_t> passes;
    bool streams_tiles = false;  ///< the tiles of the last pass are sent as they are finished
    std::vector<Attribute> attributes;  ///< what of this belongs in a file's header
};

/// Bytes of memory that a film of this encoding takes while it is made and encoded.
[[nodiscard]] std::uint64_t film_job_bytes(ImageSize size, std::string_view encode,
                                           const FilmOptions& options);
}  // namespace raynest::server
