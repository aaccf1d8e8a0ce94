// raynest gc: removes what is left of damaged and replaced scenes in the daemon's state folder.
#include "client/commands/commands.h"

namespace raynest::client {

void declare(CommandLine& /*line*/, GcOptions& /*options*/) {}

Result<void> run(Context& context, const GcOptions& /*options*/) {
    AdminOptions collect;
    collect.act = "gc";
    return run(context, collect);
}

}  // namespace raynest::client
