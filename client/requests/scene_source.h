// Scenes on their way to the daemon: the end of `load`, and files in the place of a scene's name.
#pragma once

#include "client/ground/progress.h"
#include "client/net/connection.h"
#include "client/requests/upload.h"

#include <string>

namespace raynest::client {

/// Runs a Load to its end and sends the files that the daemon asks for. The lists of files are
/// filled in here; the rest of `message` is the caller's.
Result<Reply<wire::Loaded>> load_scene(Connection& connection, Progress& progress,
                                       wire::LoadT message, const Upload& upload);

/// True for a file of a scene, builtin:NAME and root:PATH; false for the name of a loaded scene.
[[nodiscard]] bool is_source(const std::string& scene);

/// Loads a file in the place of a name. The scene belongs to the connection and goes with it; its
/// name is the file's stem and a checksum, so that it stands in the way of no other. Returns it.
Result<std::string> load_for_connection(Connection& connection, Progress& progress,
                                        const std::string& source);

}  // namespace raynest::client
