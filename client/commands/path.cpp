// raynest path SCENE ID: which instances a path id stands for.
#include "client/commands/commands.h"
#include "client/output.h"

#include <iostream>

namespace raynest::client {

Result<void> run(Context& context, const PathOptions& options) {
    wire::PathT request;
    request.scene = options.scene;
    request.path = options.id;
    request.epoch = options.epoch;
    const auto reply = ask<wire::PathName>(context.connection, request);
    if (!reply) return tl::unexpected<Failure>(reply.error());
    const wire::PathName& path = *reply->message.table;
    if (!context.json) {
        std::cout << protocol::text(path.name()) << '\n';
        return {};
    }
    Json steps = Json::array();
    const std::vector<std::string> names = protocol::strings(path.steps());
    for (std::size_t k = 0; k < names.size(); ++k) {
        const auto i = static_cast<flatbuffers::uoffset_t>(k);
        steps.push_back(Json{{"name", names[k]},
                             {"instance", path.instances()->Get(i)},
                             {"uid", path.uids()->Get(i)}});
    }
    print_json(Json{{"path", options.id}, {"name", protocol::text(path.name())}, {"steps", steps}});
    return {};
}

}  // namespace raynest::client
