// raynest pin: scenes that stay in memory while others go to the disk.
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/output/output.h"

#include <iostream>

namespace raynest::client {
namespace {

struct PinOptions {
    std::vector<std::string> scenes;
    bool off = false;
};

}  // namespace

void declare(CommandLine& line, PinOptions& pin) {
    line.add_options(
            "SCENE", pin.scenes,
            "names of loaded scenes of yours. They stay in memory, also after a restart, while "
            "unused scenes go to the disk of --state when --memory runs short")
        .required();
    line.add_flag("--off", pin.off, "they may go to the disk again");
}

Result<void> run(Context& context, const PinOptions& options) {
    Json names = Json::array();
    for (const std::string& scene : options.scenes) {
        wire::PinT request;
        request.scene = scene;
        request.off = options.off;
        const auto reply = ask<wire::Pinned>(context.connection, request);
        if (!reply) return tl::unexpected<Failure>(reply.error());
        names.push_back(std::string(protocol::text((*reply)->name())));
        if (!context.json)
            std::cout << names.back().get<std::string>()
                      << (options.off ? " may leave the memory\n" : " stays in memory\n");
    }
    if (context.json) print_json(Json{{options.off ? "unpinned" : "pinned", names}});
    return {};
}

std::unique_ptr<Command> make_pin() {
    return make_command<PinOptions>();
}

}  // namespace raynest::client
