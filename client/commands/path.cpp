// raynest path SCENE PATH: lists the steps of a path, given by its id or text.
#include "client/arguments/shared_options.h"
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/output/output.h"

#include <iostream>

namespace raynest::client {
namespace {

struct PathOptions {
    std::string scene;
    std::string path;  ///< an id, or a text such as birch-17/leaves
    std::uint64_t epoch = 0;
};

}  // namespace

void declare(CommandLine& line, PathOptions& path) {
    add_scene(line, path.scene);
    line.add_option("PATH", path.path,
                    "the path of a hit: its id, or its text such as birch-17/leaves")
        .required();
    add_epoch(line, path.epoch);
}

Result<void> run(Context& context, const PathOptions& options) {
    wire::PathT request;
    request.scene = options.scene;
    request.text = options.path;
    request.epoch = options.epoch;
    const auto reply = ask<wire::PathName>(context.connection, request);
    if (!reply) return tl::unexpected<Failure>(reply.error());
    const wire::PathName& path = *reply->message.table;
    if (!context.json) {
        if (options.path.find_first_not_of("0123456789") == std::string::npos)
            std::cout << protocol::text(path.name()) << '\n';
        else
            std::cout << path.path() << '\n';
        return {};
    }
    Json steps = Json::array();
    const std::vector<std::string> names = protocol::strings(path.steps());
    for (std::size_t k = 0; k < names.size(); ++k) {
        const auto i = static_cast<flatbuffers::uoffset_t>(k);
        const std::uint32_t node = path.nodes()->Get(i);
        steps.push_back(Json{{"name", names[k]},
                             {"instance", path.instances()->Get(i)},
                             {"uid", path.uids()->Get(i)},
                             {"node", node == 0xFFFFFFFF ? Json(nullptr) : Json(node)}});
    }
    print_json(
        Json{{"path", path.path()}, {"name", protocol::text(path.name())}, {"steps", steps}});
    return {};
}

std::unique_ptr<Command> make_path() {
    return make_command<PathOptions>();
}

}  // namespace raynest::client
