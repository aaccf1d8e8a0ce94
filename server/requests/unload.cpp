// UNLOAD: drops references to one scene, to all scenes of the caller, or to those unused for a
// given time. Running jobs and other connections keep theirs.
#include "server/ground/limited_log.h"
#include "server/requests/request.h"
#include "server/store/scene_store.h"
#include "protocol/text.h"

#include <algorithm>
#include <chrono>

namespace raynest::server {
namespace {

/// Maximum idle time, a century; a clock of 64-bit nanoseconds can still count it.
constexpr std::uint64_t idle_ms_max = 100ULL * 366 * 24 * 3600 * 1000;
/// Maximum scenes per answer, so that the longest names fit; the client repeats until none is left.
constexpr std::size_t unloads_max = 128;

}  // namespace

Reply<Answer> unload(const Services& services, const Caller& caller,
                     const protocol::Opened<wire::Unload>& message) {
    wire::UnloadedT unloaded;
    std::vector<SceneStore::Unloaded> done;
    if (message->all() || message->idle_ms() != 0) {
        const std::uint64_t idle_ms = message->all() ? 0 : message->idle_ms();
        const std::chrono::milliseconds idle(std::min(idle_ms, idle_ms_max));
        done = services.scenes.unload_idle(idle, unloads_max, caller);
    } else {
        unloaded.name = protocol::text(message->scene());
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
    return answer_with(caller, unloaded, services);
}

}  // namespace raynest::server
