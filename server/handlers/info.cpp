// INFO: what a scene holds.
#include "server/handlers/handler.h"
#include "server/handlers/scene_info.h"

namespace raynest::server {

Reply<Answer> info(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Info>& message) {
    const auto scene = services.scenes.find(protocol::text(message->scene()), 0);
    if (!scene) return tl::unexpected(scene.error());
    return answer_with(caller, scene_info(*scene, services.limits), services);
}

}  // namespace raynest::server
