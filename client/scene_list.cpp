#include "client/scene_list.h"

namespace raynest::client {

Result<std::vector<ListedScene>> list_scenes(Connection& connection) {
    std::vector<ListedScene> scenes;
    wire::ScenesT request;
    // An empty page ends a list that shrank meanwhile.
    for (bool more = true; more;) {
        const auto page = ask<wire::SceneList>(connection, request);
        if (!page) return tl::unexpected<Failure>(page.error());
        const wire::SceneList& list = *page->message.table;
        const std::vector<std::string> names = protocol::strings(list.names());
        const std::vector<std::string> hashes = protocol::strings(list.hashes());
        std::vector<std::string> shares = protocol::strings(list.shares());
        shares.resize(names.size());
        for (std::size_t k = 0; k < names.size(); ++k) {
            const auto i = static_cast<flatbuffers::uoffset_t>(k);
            scenes.push_back({names[k], hashes[k], list.owners()->Get(i)->str(), shares[k],
                              list.epochs()->Get(i), list.instanced_triangles()->Get(i),
                              list.bytes()->Get(i),
                              static_cast<double>(list.age_ms()->Get(i)) / 1e3,
                              static_cast<double>(list.idle_ms()->Get(i)) / 1e3,
                              list.holders()->Get(i)});
        }
        request.first += static_cast<std::uint32_t>(names.size());
        more = !names.empty() && request.first < list.total();
    }
    return scenes;
}

}  // namespace raynest::client
