// EDIT: instances of a scene move, hide, go and come; the result is its next epoch.
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
    order.keep = message->keep();
    order.content = edit_content(*message.table);
    const auto scene = services.scenes.find(order.scene, order.epoch, caller);
    if (!scene) return tl::unexpected(scene.error());
    if (const auto allowed = services.scenes.may_edit(order.scene, caller); !allowed)
        return tl::unexpected(allowed.error());
    if (order.keep)
        if (const auto kept =
                services.scenes.may_keep(order.scene, services.state != nullptr, caller);
            !kept)
            return tl::unexpected(kept.error());
    const std::vector<std::string> names = protocol::strings(message->names());
    const std::vector<std::string> sources = protocol::strings(message->scenes());
    const auto added = services.scenes.find_each(sources, caller);
    if (!added) return tl::unexpected(added.error());
    for (std::size_t i = 0; i < sources.size(); ++i) {
        const std::string name = i < names.size() ? names[i] : "";
        // Another owner's scene is "OWNER/NAME".
        order.content.sources.push_back(
            {(*added)[i].held, name.empty() ? sources[i].substr(sources[i].rfind('/') + 1) : name,
             (*added)[i].reading});
    }
    const std::uint64_t bytes = order.content.bytes();
    auto lease = services.peers.reserve(bytes, caller.principal);
    if (!lease)
        return services.budget.refuse("the rows and vertices of the edit", bytes, caller.principal,
                                      "send fewer at a time");
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
