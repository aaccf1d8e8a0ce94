// SCENES: lists scenes, a page at a time.
#include "server/handlers/handler.h"

#include <algorithm>
#include <chrono>

namespace raynest::server {
namespace {

constexpr std::size_t page_scenes = 128;
/// Maximum bytes of a page's names, hashes and owners: with the numbers, the page stays within
/// control_bytes_max. It suffices for 128 scenes with the longest names and usual owners.
constexpr std::size_t page_text_bytes = 50 << 10;

std::uint64_t milliseconds(SceneStore::Clock::duration duration) {
    return static_cast<std::uint64_t>(
        std::chrono::duration_cast<std::chrono::milliseconds>(duration).count());
}

}  // namespace

Reply<Answer> scenes(const Services& services, const Caller& caller,
                     const protocol::Opened<wire::Scenes>& message) {
    const std::vector<SceneStore::Listed> all = services.scenes.list(caller);
    const std::size_t first = std::min<std::size_t>(message->first(), all.size());
    const std::size_t last = std::min(all.size(), first + page_scenes);

    wire::SceneListT list;
    list.first = static_cast<std::uint32_t>(first);
    list.total = static_cast<std::uint32_t>(all.size());
    std::size_t text_bytes = 0;
    for (std::size_t i = first; i < last; ++i) {
        const SceneStore::Listed& listed = all[i];
        const Snapshot& snapshot = listed.scene.snapshot();
        text_bytes += listed.scene.name.size() + snapshot.digest().size() + listed.owner.size() +
                      listed.share.size();
        if (text_bytes > page_text_bytes && i != first) break;
        list.names.push_back(listed.scene.name);
        list.hashes.push_back(snapshot.digest());
        list.epochs.push_back(listed.scene.epoch);
        list.instanced_triangles.push_back(snapshot.statistics().instanced_triangles);
        list.bytes.push_back(snapshot.statistics().bytes);
        list.owners.push_back(listed.owner);
        list.shares.push_back(listed.share);
        list.age_ms.push_back(milliseconds(listed.age));
        list.idle_ms.push_back(milliseconds(listed.idle));
        list.holders.push_back(static_cast<std::uint32_t>(listed.holders));
    }
    return answer_with(caller, list, services);
}

}  // namespace raynest::server
