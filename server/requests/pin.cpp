// PIN: a scene stays in memory, or no longer.
#include "protocol/text.h"
#include "server/requests/request.h"
#include "server/store/scene_store.h"

#include <utility>

namespace raynest::server {

Reply<Answer> pin(const Services& services, const Caller& caller,
                  const protocol::Opened<wire::Pin>& message) {
    auto name = services.scenes.pin(protocol::text(message->scene()), !message->off(), caller);
    if (!name) return tl::unexpected(name.error());
    wire::PinnedT pinned;
    pinned.name = std::move(*name);
    pinned.pinned = !message->off();
    return answer_with(caller, pinned, services);
}

}  // namespace raynest::server
