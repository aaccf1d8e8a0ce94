// raynest load SOURCE: uploads the files that the daemon lacks and waits until the scene is built.
#include "client/commands/commands.h"
#include "client/files/files.h"
#include "client/ground/json.h"
#include "client/ground/text.h"
#include "client/output/output.h"
#include "client/output/scene_text.h"
#include "client/requests/scene_source.h"

#include <iostream>

namespace raynest::client {
namespace {

wire::LoadT load_message(const LoadOptions& options, const Upload& upload) {
    wire::LoadT load;
    load.name = options.name.empty() ? upload.scene_name : options.name;
    load.replace = options.replace;
    load.build = options.build;
    load.primitive = options.primitive;
    load.origin_x = options.origin[0];
    load.origin_y = options.origin[1];
    load.origin_z = options.origin[2];
    load.masks = options.masks;
    load.share = options.share;
    return load;
}

}  // namespace

Result<void> run(Context& context, const LoadOptions& options) {
    context.progress.update(0, 0, "reading");
    const Result<Upload> upload = gather(options.source, options.primitive, options.instances);
    if (!upload) return tl::unexpected<Failure>(upload.error());
    if (options.name.empty() && upload->scene_name.empty() && !upload->files.empty())
        return fail(Exit::usage, "a scene of " + shown_name(options.source) +
                                     " has no name of its own; pass --name NAME");
    const auto loaded =
        load_scene(context.connection, context.progress, load_message(options, *upload), *upload);
    context.progress.clear();
    if (!loaded) return tl::unexpected<Failure>(loaded.error());

    const wire::SceneInfo& info = protocol::present((*loaded)->info());
    const double seconds = (*loaded)->seconds();
    if (context.json) {
        Json json = scene_json(info);
        json["seconds"] = seconds;
        json["reused"] = (*loaded)->reused();
        print_json(json);
    } else {
        print_scene(info);
        std::cout << ((*loaded)->reused() ? "was loaded already"
                                          : "loaded in " + seconds_text(seconds))
                  << '\n';
    }
    return {};
}

}  // namespace raynest::client
