// Options of a request that change nothing: they are told, not passed over.
#pragma once

#include "protocol/control.h"

#include <string>
#include <string_view>

namespace raynest::server {

// Each returns one note that names such options; empty if there are none.

/// Options that the integrator or the file of a picture or path does not use.
[[nodiscard]] std::string idle_options_note(const wire::Render& message,
                                            std::string_view integrator);
/// Options that the file of a heat map does not use: png, exr or raw; empty without one.
[[nodiscard]] std::string idle_options_note(const wire::Heatmap& message, std::string_view file);
/// Options of a job that hides something or `hides_nothing`.
[[nodiscard]] std::string idle_options_note(const wire::Job& message, bool hides_nothing);

}  // namespace raynest::server
