// INFO: describes a scene. With `hold`, the connection keeps the scene from then on.
#include "protocol/text.h"
#include "server/documents/scene_info.h"
#include "server/requests/request.h"
#include "server/store/scene_store.h"

namespace raynest::server {

Reply<Answer> info(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Info>& message) {
    const std::string_view name = protocol::text(message->scene());
    const auto scene = message->hold() ? services.scenes.open(name, caller)
                                       : services.scenes.find(name, 0, caller);
    if (!scene) return tl::unexpected(scene.error());
    return answer_with(caller, scene_info(*scene, services.registry, services.limits), services);
}

}  // namespace raynest::server
