// Puts a scene at the moment of its animation that a request names.
#pragma once

#include "protocol/text.h"
#include "server/jobs/scene_poser.h"
#include "server/jobs/services.h"
#include "server/security/caller.h"
#include "server/store/named_scene.h"

#include <optional>
#include <string_view>
#include <utility>

namespace raynest::server {

struct MomentWords {
    std::optional<double> time;  ///< nothing: the scene as it was loaded and edited
    std::string_view animation;  ///< its name or number; empty: the first
};

/// The words lie in the message.
template <class Message>
[[nodiscard]] MomentWords moment_words(const Message& message) {
    MomentWords words;
    if (message.timed()) words.time = message.time();
    words.animation = protocol::text(message.animation());
    return words;
}

/// Returns the scene at the moment. Fails as ScenePoser::find(): a request whose scene is made first
/// is asked again. Io thread only.
inline Reply<NamedScene> at_moment(const Services& services, const Caller& caller, NamedScene scene,
                                   const MomentWords& words) {
    if (words.time && services.poser != nullptr)
        return services.poser->find(scene, words.animation, *words.time, caller);
    if (!words.animation.empty())
        return refuse(protocol::Code::invalid_field,
                      "`animation` is given and no moment of it: give `time`, too");
    return scene;
}

}  // namespace raynest::server
