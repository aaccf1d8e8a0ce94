// Files of the source tree that are part of the program: those of server/web, and the schema.
#pragma once

#include <string_view>

namespace raynest::server {

/// Returns the content of a file, whose last byte is followed by a zero; nothing (a null pointer)
/// for an unknown name. Names are paths in the source tree, e.g. "server/web/index.html".
[[nodiscard]] std::string_view embedded_file(std::string_view name);

}  // namespace raynest::server
