// PATH: a flat path id as the names of the instances on the way down.
#include "engine/scene/snapshot.h"
#include "server/handlers/handler.h"
#include "server/handlers/scene_info.h"

namespace raynest::server {

Reply<Answer> path(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Path>& message) {
    const auto scene =
        services.scenes.find(protocol::text(message->scene()), message->epoch(), caller);
    if (!scene) return tl::unexpected(scene.error());
    const auto steps = expand_path(scene->snapshot().view(), message->path());
    // The engine calls any damage of a scene invalid; here it is the request that names no path.
    if (!steps) return refuse(Code::invalid_field, steps.error().message);

    wire::PathNameT name;
    name.name = clean_text(path_name(*steps), services.limits.text_bytes_max);
    for (const PathStep& step : *steps) {
        name.steps.push_back(clean_text(step.name, services.limits.name_bytes_max));
        name.instances.push_back(step.instance);
        name.uids.push_back(step.uid);
    }
    return answer_with(caller, name, services);
}

}  // namespace raynest::server
