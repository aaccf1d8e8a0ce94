// UNLOAD: drops the caller's reference to a scene; running jobs keep theirs.
#include "server/handlers/handler.h"

namespace raynest::server {

Reply<Answer> unload(const Services& services, const Caller& caller,
                     const protocol::Opened<wire::Unload>& message) {
    const std::string_view name = protocol::text(message->scene());
    if (const auto gone = services.scenes.unload(name, caller.principal); !gone)
        return tl::unexpected(gone.error());
    wire::UnloadedT unloaded;
    unloaded.name = name;
    return answer_with(caller, unloaded, services);
}

}  // namespace raynest::server
