// SCENES: the list of scenes, a page at a time.
#include "server/handlers/handler.h"

#include <algorithm>

namespace raynest::server {
namespace {

/// Names of the longest kind and hashes of a page stay far below the size of a message.
constexpr std::size_t page_scenes = 128;

}  // namespace

Reply<Answer> scenes(const Services& services, const Caller& caller,
                     const protocol::Opened<wire::Scenes>& message) {
    const std::vector<NamedScene> all = services.scenes.list();
    const std::size_t first = std::min<std::size_t>(message->first(), all.size());
    const std::size_t last = std::min(all.size(), first + page_scenes);

    wire::SceneListT list;
    list.first = static_cast<std::uint32_t>(first);
    list.total = static_cast<std::uint32_t>(all.size());
    for (std::size_t i = first; i < last; ++i) {
        const SceneStatistics& statistics = all[i].snapshot().statistics();
        list.names.push_back(all[i].name);
        list.hashes.push_back(all[i].snapshot().hash());
        list.epochs.push_back(all[i].epoch);
        list.instanced_triangles.push_back(statistics.instanced_triangles);
        list.bytes.push_back(statistics.bytes);
    }
    return answer_with(caller, list, services);
}

}  // namespace raynest::server
