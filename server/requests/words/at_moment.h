// Puts a scene at the moment of its animation that a request names.
#pragma once

#include "protocol/text.h"
#include "server/jobs/scene_poser.h"
#include "server/jobs/services.h"
#include "server/security/caller.h"
#include "server/store/named_scene.h"

#include <utility>

namespace raynest::server {

/// Returns the scene at `time` of `animation`, or as it was loaded and edited if the message is not
/// `timed`. Fails as ScenePoser::find(): a request whose scene is made first is asked again. Io
/// thread only.
template <class Message>
Reply<NamedScene> at_moment(const Services& services, const Caller& caller, NamedScene scene,
                            const Message& message) {
    const std::string_view animation = protocol::text(message.animation());
    if (message.timed() && services.poser != nullptr)
        return services.poser->find(scene, animation, message.time(), caller);
    if (!animation.empty())
        return refuse(protocol::Code::invalid_field,
                      "`animation` is given and no moment of it: give `time`, too");
    return scene;
}

}  // namespace raynest::server
