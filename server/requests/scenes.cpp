// SCENES: lists scenes, a page at a time.
#include "server/requests/request.h"
#include "server/store/scene_store.h"

#include <algorithm>
#include <chrono>

namespace raynest::server {
namespace {

constexpr std::size_t page_scenes = 128;
/// Maximum bytes of a page's names, hashes and owners: with the numbers, the page stays within
/// control_bytes_max. It suffices for 128 scenes with the longest names and usual owners.
constexpr std::size_t scenes_text_bytes = 50 << 10;

std::uint64_t milliseconds(SceneStore::Clock::duration duration) {
    return static_cast<std::uint64_t>(
        std::chrono::duration_cast<std::chrono::milliseconds>(duration).count());
}

}  // namespace

Reply<Answer> scenes(const Services& services, const Caller& caller,
                     const protocol::Opened<wire::Scenes>& message) {
    const SceneStore::Page page = services.scenes.page(caller, message->first(), page_scenes);

    wire::SceneListT list;
    list.first = static_cast<std::uint32_t>(std::min<std::size_t>(message->first(), page.total));
    list.total = static_cast<std::uint32_t>(page.total);
    std::size_t text_bytes = 0;
    for (const SceneStore::Listed& listed : page.scenes) {
        text_bytes += listed.scene.name.size() + listed.facts.digest.size() + listed.owner.size() +
                      listed.share.size();
        if (text_bytes > scenes_text_bytes && !list.names.empty()) break;
        list.names.push_back(listed.scene.name);
        list.hashes.push_back(listed.facts.digest);
        list.epochs.push_back(listed.scene.epoch);
        list.instanced_triangles.push_back(listed.facts.instanced_triangles);
        list.bytes.push_back(listed.facts.bytes);
        list.owners.push_back(listed.owner);
        list.shares.push_back(listed.share);
        list.states.push_back(listed.state);
        list.age_ms.push_back(milliseconds(listed.age));
        list.idle_ms.push_back(milliseconds(listed.idle));
        list.holders.push_back(static_cast<std::uint32_t>(listed.holders));
    }
    return answer_with(caller, list, services);
}

}  // namespace raynest::server
