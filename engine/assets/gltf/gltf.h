// glTF 2.0 import. file/model.h explains how the files work together.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/result.h"
#include "engine/scene/description.h"

namespace raynest {

/// Reads `request.files[0]`, a .glb or .gltf; the other files are those that it names. Bytes of any
/// content give a description or an error; no file outside the request is opened.
///
/// glTF has +Y up. A scene with `extras.raynest.up` "z", as an export of a scene with +Z up has, is
/// turned back to what it was.
Result<SceneDescription> describe_gltf(const ImportRequest& request, const ImportLimits& limits);

}  // namespace raynest
