// UNLOAD: drops references to one scene, to all scenes of the caller, or to those unused for a
// given time. Running jobs and other connections keep theirs.
#include "protocol/answer.h"
#include "protocol/text.h"
#include "server/ground/limited_log.h"
#include "server/jobs/disk_job.h"
#include "server/requests/request.h"
#include "server/store/scene_store.h"
#include "server/store/state_folder.h"

#include <algorithm>
#include <chrono>

namespace raynest::server {
namespace {

/// Maximum idle time, a century; a clock of 64-bit nanoseconds can still count it.
constexpr std::uint64_t idle_ms_max = 100ULL * 366 * 24 * 3600 * 1000;
/// Maximum scenes per answer, so that the longest names fit; the client repeats until none is left.
constexpr std::size_t unloads_max = 128;

/// The scenes that a message asks for.
struct UnloadOrder {
    std::string scene;
    bool many = false;  ///< all scenes that are idle for as long
    std::chrono::milliseconds idle{};
};

Reply<wire::UnloadedT> unload_now(const Services& services, const Caller& caller,
                                  const UnloadOrder& order) {
    wire::UnloadedT unloaded;
    std::vector<SceneStore::Unloaded> done;
    if (order.many) {
        done = services.scenes.unload_idle(order.idle, unloads_max, caller);
    } else {
        unloaded.name = order.scene;
        auto holders = services.scenes.unload(unloaded.name, caller);
        if (!holders) return tl::unexpected(holders.error());
        unloaded.holders = *holders;
        done.push_back({unloaded.name, std::move(*holders)});
    }
    for (const auto& [name, holders] : done) {
        unloaded.names.push_back(name);
        // Name the other holders: the last of them frees the memory.
        std::string still_held_by;
        for (const std::string& holder : holders)
            still_held_by += (still_held_by.empty() ? "" : ", ") + holder;
        if (holders.empty())
            log_limited(LogLevel::info, "unloaded", caller.principal,
                        {{"scene", name}, {"principal", caller.principal}});
        else
            log_limited(LogLevel::info, "released", caller.principal,
                        {{"scene", name},
                         {"principal", caller.principal},
                         {"still_held_by", still_held_by}});
    }
    return unloaded;
}

}  // namespace

Reply<Answer> unload(const Services& services, const Caller& caller,
                     const protocol::Opened<wire::Unload>& message) {
    UnloadOrder order;
    order.scene = protocol::text(message->scene());
    order.many = message->all() || message->idle_ms() != 0;
    if (!message->all())
        order.idle = std::chrono::milliseconds(std::min(message->idle_ms(), idle_ms_max));
    if (services.state != nullptr) {
        JobSubmission accepted;
        accepted.kind = "unload";
        accepted.scene = order.scene;
        accepted.job = disk_job(services, [&services, caller, order]() -> Reply<WriteToDisk> {
            auto unloaded = unload_now(services, caller, order);
            if (!unloaded) return tl::unexpected(unloaded.error());
            // Also for nothing: the memory that was freed may have held the last pin of a blob.
            return [&services, id = caller.request_id, unloaded = std::move(*unloaded),
                    rows = services.scenes.take_dropped()]() -> Reply<protocol::Frame> {
                const auto removed = services.state->remove(rows);
                if (removed) return protocol::answer(id, unloaded);
                return refuse(Code::resource_exhausted,
                              removed.error().message + "; after a restart it is there again");
            };
        });
        return Answer{std::move(accepted)};
    }
    const auto unloaded = unload_now(services, caller, order);
    if (!unloaded) return tl::unexpected(unloaded.error());
    return answer_with(caller, *unloaded, services);
}

}  // namespace raynest::server
