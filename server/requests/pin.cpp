// PIN: a scene stays in memory, or no longer.
#include "protocol/answer.h"
#include "protocol/text.h"
#include "server/jobs/disk_job.h"
#include "server/requests/request.h"
#include "server/store/scene_store.h"
#include "server/store/state_folder.h"

#include <utility>

namespace raynest::server {

Reply<Answer> pin(const Services& services, const Caller& caller,
                  const protocol::Opened<wire::Pin>& message) {
    auto name = services.scenes.pin(protocol::text(message->scene()), !message->off(), caller);
    if (!name) return tl::unexpected(name.error());
    wire::PinnedT pinned;
    pinned.name = std::move(*name);
    pinned.pinned = !message->off();
    if (services.state == nullptr) return answer_with(caller, pinned, services);
    JobSubmission accepted;
    accepted.kind = "pin";
    accepted.scene = pinned.name;
    accepted.job = disk_job(
        services,
        [&services, id = caller.request_id, pinned = std::move(pinned)]() -> Reply<WriteToDisk> {
            return [&services, id, pinned,
                    uses = services.scenes.take_uses()]() -> Reply<protocol::Frame> {
                const auto written = services.state->put(uses);
                if (written) return protocol::answer(id, pinned);
                services.state->note(uses);
                return refuse(Code::resource_exhausted,
                              written.error().message +
                                  "; after a restart the scene may be as it "
                                  "was");
            };
        });
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
