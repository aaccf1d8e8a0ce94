// raynest unload SCENE: drop the caller's reference.
#include "client/commands/commands.h"
#include "client/output.h"

#include <iostream>

namespace raynest::client {

Result<void> run(Context& context, const UnloadOptions& options) {
    wire::UnloadT request;
    request.scene = options.scene;
    const auto reply = ask<wire::Unloaded>(context.connection, request);
    if (!reply) return tl::unexpected<Failure>(reply.error());
    if (context.json)
        print_json(Json{{"unloaded", protocol::text((*reply)->name())}});
    else
        std::cout << "unloaded " << protocol::text((*reply)->name()) << '\n';
    return {};
}

}  // namespace raynest::client
