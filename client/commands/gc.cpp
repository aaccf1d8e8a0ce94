// raynest gc: removes what is left of damaged and replaced scenes in the daemon's state folder.
#include "client/commands/deliver.h"

namespace raynest::client {
namespace {

struct GcOptions {};

}  // namespace

void declare(CommandLine& /*line*/, GcOptions& /*options*/) {}

Result<void> run(Context& context, const GcOptions& /*options*/) {
    wire::AdminT request;
    request.act = "gc";
    return report_act(context, request);
}

std::unique_ptr<Command> make_gc() {
    return make_command<GcOptions>();
}

}  // namespace raynest::client
