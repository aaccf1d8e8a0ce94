// The pictures that a client sends with a request for a film: decoded in the import child, then
// checked.
//
// Both functions wait for that process, whose memory is charged to `principal`: call them on
// Services::blocking. A stopped task ends it.
#pragma once

#include "engine/assets/images/image.h"
#include "engine/integrators/film.h"
#include "engine/integrators/integrator.h"
#include "server/jobs/services.h"
#include "server/scheduling/job.h"

#include <cstdint>
#include <memory>
#include <span>
#include <string>

namespace raynest::server {

/// Bytes of a picture of the surroundings, decoded, at most.
[[nodiscard]] std::uint64_t environment_room(std::uint64_t file_bytes);

/// Decodes a picture of the surroundings. Fails with INVALID_FIELD, saying what is wrong with it.
Reply<std::shared_ptr<const EnvironmentPicture>> read_environment(const Services& services,
                                                                  const std::string& principal,
                                                                  std::span<const std::byte> file,
                                                                  const Stop& stop);

/// Fills a film from an EXR that encode_film() made. `attributes` are those that the request would
/// write: the file must have the same, except for the number of samples and the names of its scene
/// and camera. Its pixels must be finite, with at most `samples` samples each. Fails with
/// INVALID_FIELD, saying what differs, or with the decoder's error.
Reply<void> read_film(const Services& services, const std::string& principal,
                      std::span<const std::byte> file, std::span<const Attribute> attributes,
                      std::uint32_t samples, const Stop& stop, Film& film);

/// Checks the values of a film from outside: floats are finite, the variance is not negative, and
/// pixels have at most `samples` samples, dropped ones included.
Reply<void> check_film(const Film& film, std::uint32_t samples);

}  // namespace raynest::server
