// raynest scenes: lists the loaded scenes.
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/ground/text.h"
#include "client/output/output.h"
#include "client/requests/listings.h"

namespace raynest::client {
namespace {

struct ScenesOptions {};

/// Digits of a hash in the table; --json has all 64.
constexpr std::size_t short_hash_digits = 16;

}  // namespace

void declare(CommandLine&, ScenesOptions&) {}

Result<void> run(Context& context, const ScenesOptions&) {
    const auto scenes = list_scenes(context.connection);
    if (!scenes) return tl::unexpected<Failure>(scenes.error());
    Json list = Json::array();
    std::vector<std::vector<std::string>> rows = {{"SCENE", "EPOCH", "TRIANGLES", "BYTES", "STATE",
                                                   "OWNER", "SHARED WITH", "AGE", "UNUSED", "OPEN",
                                                   "HASH (FIRST 16)"}};
    for (const ListedScene& scene : *scenes) {
        list.push_back(Json{{"name", scene.name},
                            {"hash", scene.hash},
                            {"epoch", scene.epoch},
                            {"instanced_triangles", scene.triangles},
                            {"bytes", scene.bytes},
                            {"state", scene.state},
                            {"owner", scene.owner},
                            {"share", scene.share},
                            {"age_seconds", scene.age_seconds},
                            {"idle_seconds", scene.idle_seconds},
                            {"holders", scene.holders}});
        rows.push_back({scene.name, std::to_string(scene.epoch), grouped(scene.triangles),
                        bytes_text(scene.bytes), scene.state, scene.owner,
                        scene.share.empty() ? "-" : scene.share, age_text(scene.age_seconds),
                        age_text(scene.idle_seconds), std::to_string(scene.holders),
                        scene.hash.substr(0, short_hash_digits)});
    }
    if (context.json)
        print_json(Json{{"scenes", list}});
    else
        print_table(rows);
    return {};
}

std::unique_ptr<Command> make_scenes() {
    return make_command<ScenesOptions>();
}

}  // namespace raynest::client
