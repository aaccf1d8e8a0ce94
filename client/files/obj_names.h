// Reads the names of the files that an OBJ and its MTL files name.
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

/// Returns the MTL files of an .obj, or the pictures of an .mtl, each once, beneath the scene's
/// folder; `file` is the name of the file itself, to whose folder names are relative. Names outside
/// the scene's folder are left out: the daemon complains of them. Returns none for other files.
std::vector<std::string> obj_names(std::string_view file, std::span<const std::byte> bytes);

}  // namespace raynest::client
