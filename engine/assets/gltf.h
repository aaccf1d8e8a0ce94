// glTF 2.0 import. How the files work together: gltf_model.h.
#pragma once

#include "engine/assets/import.h"

namespace raynest {

/// Does the source's name end so? Letters of either case, as Windows tools write them.
[[nodiscard]] bool has_extension(std::string_view source, std::string_view extension);

/// `request.files[0]` is a .glb or .gltf, the others are what it names. Bytes of any content end in
/// a description or an error; no file outside the request is opened.
Result<SceneDescription> describe_gltf(const ImportRequest& request, const ImportLimits& limits);

}  // namespace raynest
