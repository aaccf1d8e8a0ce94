// Options of a picture that its integrator or its file does not use.
#pragma once

#include "protocol/control.h"

#include <string>
#include <string_view>

namespace raynest::server {

/// Returns one note that names the options of a request that change nothing; empty if there are none.
[[nodiscard]] std::string idle_options_note(const wire::Render& message,
                                            std::string_view integrator);

}  // namespace raynest::server
