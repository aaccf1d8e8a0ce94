// The files that an OBJ and its MTL files name: for the import, and for who reads them before it.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest {

/// Returns the uploaded file that `text` of the file `by` names: relative to that file's folder,
/// with / for \, as gltf::file_of_uri() does but without percent signs. Nothing if it is absolute
/// or leaves the scene's folder. Clients apply the same rule.
[[nodiscard]] std::optional<std::string> file_of_name(std::string_view by, std::string_view text);

/// Returns the files of the words behind "mtllib": each word where all of them end in ".mtl", else
/// one file whose name has blanks.
[[nodiscard]] std::vector<std::string_view> files_of_mtllib(std::string_view words);

/// Returns the picture of the words behind "map_Kd", without options as in "-s 2 2 1 leaf.png".
[[nodiscard]] std::string_view picture_of_map(std::string_view words);

/// Returns the MTL files of an .obj, or the pictures of an .mtl, by the name of the file; each
/// once, without unsafe ones, and at most `names_max`. Returns none for other files.
[[nodiscard]] std::vector<std::string> files_named_by(std::string_view file,
                                                      std::span<const std::byte> bytes,
                                                      std::size_t names_max);

}  // namespace raynest
