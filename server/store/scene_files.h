// A scene under --scene-root with the files that it names, read the way a client uploads one.
#pragma once

#include "engine/result.h"
#include "server/store/source_root.h"

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

/// The files that a .gltf or .glb names, percent-decoded, each once; nothing for other formats and
/// for bytes that are no glTF: the import will say what is wrong. Unsafe names are left out.
[[nodiscard]] std::vector<std::string> named_files(std::span<const std::byte> main_file);

/// The main file first, under its own name; then what it names beneath its folder. What is missing
/// is for the import to report; a link that leaves the folder, and what the limits or the budget do
/// not allow, is an error. Blocking.
Result<std::vector<SourceFile>> read_scene(const std::filesystem::path& root, std::string_view path,
                                           std::size_t files_max, std::uint64_t bytes_max,
                                           Budget& budget);

}  // namespace raynest::server
