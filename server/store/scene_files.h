// Reads a scene under --scene-root with the files that it names, as a client does for an upload.
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

/// Returns what a .gltf, .glb, .obj, .mtl or .rnscene.json names, beneath the folder of the scene,
/// each once, without unsafe names. `file` is its name beneath that folder. Returns none for other
/// formats and invalid files, which the import reports.
[[nodiscard]] std::vector<std::string> named_files(std::string_view file,
                                                   std::span<const std::byte> bytes,
                                                   std::size_t names_max);

/// Reads the main file, then the files that it names beneath its folder, and what these name. Skips missing files, which the import reports. Fails on a link that leaves the folder, or if the
/// limits or the budget are exceeded. Blocking.
Result<std::vector<SourceFile>> read_scene(const std::filesystem::path& root, std::string_view path,
                                           std::size_t files_max, std::uint64_t bytes_max,
                                           const LoadMemory& memory);

}  // namespace raynest::server
