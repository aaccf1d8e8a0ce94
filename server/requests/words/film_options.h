// The words of a RENDER request for a lit picture, checked, and how a film is written as a file.
#pragma once

#include "engine/assets/image.h"
#include "engine/integrators/integrator.h"
#include "engine/integrators/tonemap.h"
#include "protocol/wire.h"
#include "server/ground/errors.h"
#include "server/jobs/payload_sender.h"

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

/// Fails with INVALID_FIELD or INVALID_PARAM, naming the choices.
Reply<FilmOptions> film_options(const wire::Render& message, std::string integrator);

/// Bytes of memory that a film of this encoding takes while it is made and encoded.
[[nodiscard]] std::uint64_t film_job_bytes(ImageSize size, std::string_view encode,
                                           const FilmOptions& options);
/// Returns the maximum bytes of a film's payload.
[[nodiscard]] std::uint64_t film_payload_bytes_max(ImageSize size, std::string_view encode);

/// Encodes a film as png, exr, raw rows of RGBA, or linear rows of premultiplied RGBA in float.
Reply<Payload> encode_film(const Film& film, std::string_view encode, const Look& look,
                           std::vector<Attribute> attributes);

}  // namespace raynest::server
