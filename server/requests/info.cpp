// INFO: describes a scene, also at a moment. With `hold`, the connection keeps it from then on.
#include "protocol/text.h"
#include "server/documents/scene_info.h"
#include "server/requests/request.h"
#include "server/requests/words/at_moment.h"
#include "server/store/scene_store.h"

namespace raynest::server {

Reply<Answer> info(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Info>& message) {
    const std::string_view name = protocol::text(message->scene());
    const auto scene = services.scenes.find(name, 0, caller);
    if (!scene) return tl::unexpected(scene.error());
    const auto posed = at_moment(services, caller, *scene, moment_words(*message.table));
    if (!posed) return tl::unexpected(posed.error());
    if (message->hold())
        if (const auto held = services.scenes.open(name, caller); !held)
            return tl::unexpected(held.error());
    wire::SceneInfoT info = scene_info(*posed, services.registry, services.limits);
    info.hash = scene->snapshot().digest();
    const EditStatistics& edits = scene->snapshot().statistics().edits;  // a moment is no edit
    info.refits = edits.refits;
    info.rebuilds = edits.rebuilds;
    return answer_with(caller, info, services);
}

}  // namespace raynest::server
