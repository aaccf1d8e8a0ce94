// Reads the names of the files that an OBJ and its MTL files name.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

/// Returns the name beneath the scene's folder of the file that `text` of the file `by` names:
/// relative to the folder of that, with / for \\, without percent signs' meaning in a URI. Nothing if
/// it is absolute or leaves the scene's folder. The daemon applies the same rule.
std::optional<std::string> file_of_name(std::string_view by, std::string_view text);

/// Returns the MTL files of an .obj, or the pictures of an .mtl, each once, beneath the scene's
/// folder; `file` is the name of the file itself, to whose folder names are relative. Names outside
/// the scene's folder are left out: the daemon complains of them. Returns none for other files.
std::vector<std::string> obj_names(std::string_view file, std::span<const std::byte> bytes);

}  // namespace raynest::client
