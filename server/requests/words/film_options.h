// The words of a RENDER request for a lit picture, checked.
#pragma once

#include "protocol/wire.h"
#include "server/ground/errors.h"
#include "server/jobs/films/film_options.h"

#include <string>

namespace raynest::server {

/// Fails with INVALID_FIELD or INVALID_PARAM, naming the choices.
Reply<FilmOptions> film_options(const wire::Render& message, std::string integrator);

}  // namespace raynest::server
