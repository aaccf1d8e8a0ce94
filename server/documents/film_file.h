// A film as a file: PNG, EXR, or rows of numbers.
#pragma once

#include "engine/assets/images/image.h"
#include "engine/integrators/film.h"
#include "engine/integrators/tonemap.h"
#include "server/documents/payload.h"
#include "server/ground/errors.h"

#include <cstdint>
#include <string_view>
#include <vector>

namespace raynest::server {

/// Returns the maximum bytes of a film's payload.
[[nodiscard]] std::uint64_t film_payload_bytes_max(ImageSize size, std::string_view encode);

/// Encodes a film as png, exr, raw rows of RGBA, or linear rows of premultiplied RGBA in float.
Reply<Payload> encode_film(const Film& film, std::string_view encode, const Look& look,
                           std::vector<Attribute> attributes);

}  // namespace raynest::server
