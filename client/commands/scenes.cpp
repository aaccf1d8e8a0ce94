// raynest scenes: lists the loaded scenes.
#include "client/commands/commands.h"
#include "client/output.h"

namespace raynest::client {
namespace {

/// Digits of a hash in the table; --json has all 64.
constexpr std::size_t short_hash_digits = 16;

}  // namespace

Result<void> run(Context& context, const ScenesOptions&) {
    Json scenes = Json::array();
    std::vector<std::vector<std::string>> rows = {{"SCENE", "EPOCH", "TRIANGLES", "MEMORY", "OWNER",
                                                   "SHARED WITH", "AGE", "UNUSED", "OPEN",
                                                   "HASH (FIRST 16)"}};
    wire::ScenesT request;
    // The daemon answers page by page; an empty page ends a list that shrank meanwhile.
    for (bool more = true; more;) {
        const auto page = ask<wire::SceneList>(context.connection, request);
        if (!page) return tl::unexpected<Failure>(page.error());
        const wire::SceneList& list = *page->message.table;
        const std::vector<std::string> names = protocol::strings(list.names());
        const std::vector<std::string> hashes = protocol::strings(list.hashes());
        std::vector<std::string> shares = protocol::strings(list.shares());
        shares.resize(names.size());
        for (std::size_t k = 0; k < names.size(); ++k) {
            const auto i = static_cast<flatbuffers::uoffset_t>(k);
            const std::uint64_t epoch = list.epochs()->Get(i);
            const std::uint64_t triangles = list.instanced_triangles()->Get(i);
            const std::uint64_t bytes = list.bytes()->Get(i);
            const std::string owner = list.owners()->Get(i)->str();
            const double age = static_cast<double>(list.age_ms()->Get(i)) / 1e3;
            const double idle = static_cast<double>(list.idle_ms()->Get(i)) / 1e3;
            const std::uint32_t holders = list.holders()->Get(i);
            scenes.push_back(Json{{"name", names[k]},
                                  {"hash", hashes[k]},
                                  {"epoch", epoch},
                                  {"instanced_triangles", triangles},
                                  {"bytes", bytes},
                                  {"owner", owner},
                                  {"share", shares[k]},
                                  {"age_seconds", age},
                                  {"idle_seconds", idle},
                                  {"holders", holders}});
            rows.push_back({names[k], std::to_string(epoch), grouped(triangles), bytes_text(bytes),
                            owner, shares[k].empty() ? "-" : shares[k], age_text(age), age_text(idle), std::to_string(holders),
                            hashes[k].substr(0, short_hash_digits)});
        }
        request.first += static_cast<std::uint32_t>(names.size());
        more = !names.empty() && request.first < list.total();
    }
    if (context.json)
        print_json(Json{{"scenes", scenes}});
    else
        print_table(rows);
    return {};
}

}  // namespace raynest::client
