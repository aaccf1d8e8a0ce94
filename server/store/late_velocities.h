// How fast a posed scene moves, for the few requests that ask for it.
#pragma once

#include "engine/scene/motion/velocities.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <mutex>
#include <optional>

namespace raynest::server {

/// Made when it is first asked for, which takes as long as sampling the animation. Thread-safe.
class LateVelocities {
public:
    /// The scene, which outlives this, is posed at a moment of one of its animations.
    LateVelocities(const Snapshot& scene, std::uint32_t animation, double seconds)
        : motion_(checked_motion(scene.motion_bytes())),
          animation_(animation),
          seconds_(seconds),
          placed_(scene.view().instance_infos +
                  scene.view().objects[scene.view().root].first_instance) {}
    [[nodiscard]] const Velocities& get() const {
        std::call_once(once_, [this] {
            made_.emplace(motion_, motion_.animations[animation_], seconds_, placed_);
        });
        return *made_;
    }
    /// To reserve for it.
    [[nodiscard]] std::uint64_t bytes() const { return Velocities::bytes_for(motion_); }

private:
    const Motion motion_;
    const std::uint32_t animation_;
    const double seconds_;
    const InstanceInfo* const placed_;
    mutable std::once_flag once_;
    mutable std::optional<Velocities> made_;
};

}  // namespace raynest::server
