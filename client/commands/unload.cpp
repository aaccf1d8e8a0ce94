// raynest unload: drops scenes by name, all scenes of the caller, or those not used for long.
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/ground/numbers.h"
#include "client/output/output.h"
#include "client/requests/listings.h"

#include <iostream>

namespace raynest::client {
namespace {

/// Selects scenes by name, all, or those that were not used for `idle_ms`.
struct UnloadOptions {
    std::vector<std::string> scenes;
    bool all = false;
    std::uint64_t idle_ms = 0;
};

struct Unloaded {
    std::string name;
    std::vector<std::string> holders;  ///< known for scenes that were given by name
};

Result<void> unload(Context& context, const wire::UnloadT& request, std::vector<Unloaded>& done) {
    const bool many = request.all || request.idle_ms != 0;
    // The daemon answers page by page; the last page is empty.
    while (true) {
        const auto reply = ask<wire::Unloaded>(context.connection, request);
        if (!reply) return tl::unexpected<Failure>(reply.error());
        const std::vector<std::string> names = protocol::strings((*reply)->names());
        if (auto fits = check_listed(done.size() + names.size()); !fits) return fits;
        for (const std::string& name : names)
            done.push_back({name, protocol::strings((*reply)->holders())});
        if (!many || names.empty()) return {};
    }
}

void print(Context& context, const UnloadOptions& options, const std::vector<Unloaded>& done) {
    if (context.json) {
        Json names = Json::array();
        Json holders = Json::object();
        for (const Unloaded& scene : done) {
            names.push_back(scene.name);
            if (!scene.holders.empty()) holders[scene.name] = scene.holders;
        }
        return print_json(Json{{"unloaded", names}, {"holders", holders}});
    }
    for (const Unloaded& scene : done) {
        std::cout << "unloaded " << scene.name << '\n';
        if (scene.holders.empty()) continue;
        std::cout << "  still held by ";
        for (std::size_t i = 0; i < scene.holders.size(); ++i)
            std::cout << (i == 0 ? "" : ", ") << scene.holders[i];
        std::cout << ", who can keep using the name\n";
    }
    if (done.empty() && options.scenes.empty())
        std::cout << "nothing to unload: no scene that you named is left"
                  << (options.all ? "" : ", or unused for so long")
                  << "; scenes without a name go with their connections\n";
}

}  // namespace

void declare(CommandLine& line, UnloadOptions& unload) {
    const Option scenes =
        line.add_options("SCENE", unload.scenes, "names of loaded scenes (see: raynest scenes)");
    const Option all = line.add_flag("--all", unload.all, "every scene of yours").excludes(scenes);
    line.add_parsed(
            "--idle",
            [&unload](const std::string& text) -> std::string {
                const auto milliseconds = parse_duration(text);
                if (!milliseconds) return milliseconds.error().message;
                unload.idle_ms = *milliseconds;
                return "";
            },
            "every scene of yours that has not been used for this long: 90s, 30m, 1h, 2d")
        .excludes(scenes)
        .excludes(all);
    line.at_end([&unload] {
        const bool names_none = unload.scenes.empty() && !unload.all && unload.idle_ms == 0;
        return names_none ? "SCENE, --all or --idle is required" : "";
    });
}

Result<void> run(Context& context, const UnloadOptions& options) {
    std::vector<Unloaded> done;
    wire::UnloadT request;
    request.all = options.all;
    request.idle_ms = options.idle_ms;
    Result<void> result;
    if (options.scenes.empty()) result = unload(context, request, done);
    for (const std::string& scene : options.scenes) {
        request.scene = scene;
        const auto next = unload(context, request, done);
        if (next) continue;
        // Print all failures but the last, which the caller prints.
        if (!result) std::cerr << describe(result.error(), context.json) << '\n';
        result = next;
        if (is_own(next.error())) break;
    }
    if (result || !done.empty()) print(context, options, done);
    return result;
}

std::unique_ptr<Command> make_unload() {
    return make_command<UnloadOptions>();
}

}  // namespace raynest::client
