// EDIT: moves outermost instances of a scene and changes their masks; the result is its next epoch.
#include "protocol/text.h"
#include "server/jobs/edit_job.h"
#include "server/requests/request.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"

#include <utility>

namespace raynest::server {

Reply<Answer> edit(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Edit>& message) {
    EditOrder order;
    order.scene = protocol::text(message->scene());
    order.epoch = message->epoch();
    order.targets = protocol::strings(message->targets());
    order.rows = message->rows();
    const auto scene = services.scenes.find(order.scene, order.epoch, caller);
    if (!scene) return tl::unexpected(scene.error());
    if (const auto allowed = services.scenes.may_edit(order.scene, caller); !allowed)
        return tl::unexpected(allowed.error());
    const std::uint64_t bytes = std::uint64_t{order.rows} * sizeof(EditRow);
    auto lease = services.peers.reserve(bytes, caller.principal);
    if (!lease)
        return services.budget.refuse("the rows of the edit", bytes, caller.principal,
                                      "send fewer rows at a time");
    order.lease = std::move(*lease);

    JobSubmission accepted;
    accepted.kind = "edit";
    accepted.scene = scene->name;
    accepted.deadline_ms = message->deadline_ms();
    accepted.input_bytes = bytes;
    accepted.job = edit_job(services, caller, std::move(order));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
