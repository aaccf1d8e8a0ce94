// The words of a RENDER request for a lit picture, checked.
#pragma once

#include "server/ground/errors.h"
#include "server/jobs/films/film_options.h"
#include "server/requests/words/render_words.h"

namespace raynest::server {

/// Fails with INVALID_FIELD or INVALID_PARAM, naming the choices.
Reply<FilmOptions> film_options(const RenderWords& words);

}  // namespace raynest::server
