// The files that the files of a scene name: what `raynest load` sends with the one that it is
// given.
#pragma once

#include "client/ground/failure.h"

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

inline constexpr std::string_view composition_ending = ".rnscene.json";

struct NamedFile {
    std::string name;  ///< beneath the folder of the scene
    std::string_view spare =
        "file";  ///< the kind of one that the scene can do without; empty: none
};

/// Returns what a .gltf, .glb, .obj, .mtl or .rnscene.json names, each once; none for other files.
/// `file` is its name beneath the scene's folder. Names outside of that folder are left out: the
/// daemon complains if it needs them. Exit code 5 for a glTF that is none; the daemon says what is
/// wrong with a composition.
Result<std::vector<NamedFile>> named_files(const std::string& file,
                                           std::span<const std::byte> bytes);

}  // namespace raynest::client
