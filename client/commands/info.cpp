// raynest info SCENE: its counts, cameras and what was skipped.
#include "client/commands/commands.h"
#include "client/scene_info.h"

namespace raynest::client {

Result<void> run(Context& context, const InfoOptions& options) {
    wire::InfoT request;
    request.scene = options.scene;
    const auto info = ask<wire::SceneInfo>(context.connection, request);
    if (!info) return tl::unexpected<Failure>(info.error());
    if (context.json)
        print_json(scene_json(*info->message.table));
    else
        print_scene(*info->message.table);
    return {};
}

}  // namespace raynest::client
