// glTF 2.0 import. gltf_model.h explains how the files work together.
#pragma once

#include "engine/assets/import.h"

namespace raynest {

/// True if the source's name ends in `extension`, in upper or lower case: Windows tools write both.
[[nodiscard]] bool has_extension(std::string_view source, std::string_view extension);

/// Reads `request.files[0]`, a .glb or .gltf; the other files are those that it names. Bytes of any
/// content give a description or an error; no file outside the request is opened.
Result<SceneDescription> describe_gltf(const ImportRequest& request, const ImportLimits& limits);

}  // namespace raynest
