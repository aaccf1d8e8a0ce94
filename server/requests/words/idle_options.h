// Options of a request that change nothing: they are told, not passed over.
#pragma once

#include "server/requests/words/render_words.h"

#include <string>
#include <string_view>

namespace raynest::server {

// Each returns one note that names such options; empty if there are none.

/// Options that the integrator or the file of a picture or path does not use.
[[nodiscard]] std::string idle_options_note(const RenderWords& words);
/// Options that the file of a heat map does not use: png, exr or raw; empty without one. A palette
/// that is not given is empty.
[[nodiscard]] std::string idle_colours_note(std::string_view palette, std::string_view scale,
                                            std::string_view file);
/// Whether a job that hides something, or nothing, skips the boxes that lead to what it hides.
[[nodiscard]] std::string idle_boxes_note(bool skips_boxes, bool hides_nothing);

}  // namespace raynest::server
