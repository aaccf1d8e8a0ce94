// PIN: a scene stays in memory, or no longer.
#include "protocol/text.h"
#include "server/requests/request.h"
#include "server/store/scene_store.h"

namespace raynest::server {

Reply<Answer> pin(const Services& services, const Caller& caller,
                  const protocol::Opened<wire::Pin>& message) {
    const auto scene =
        services.scenes.pin(protocol::text(message->scene()), !message->off(), caller);
    if (!scene) return tl::unexpected(scene.error());
    wire::PinnedT pinned;
    pinned.name = scene->name;
    pinned.pinned = !message->off();
    return answer_with(caller, pinned, services);
}

}  // namespace raynest::server
