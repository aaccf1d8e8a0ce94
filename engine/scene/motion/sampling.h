// An animation at a moment: where its nodes are, and the weights of its meshes.
#pragma once

#include "engine/scene/motion/motion.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

/// The tables outlive it. Thread-safe.
class MotionSampling {
public:
    MotionSampling(const Motion& motion, const MotionAnimation& animation, double seconds)
        : motion_(motion),
          animation_(animation),
          seconds_(seconds) {}

    /// Returns the map of each node to the scene.
    [[nodiscard]] std::vector<Affine> nodes() const;
    /// Returns the weights of a mesh, by its index.
    [[nodiscard]] std::vector<float> weights(std::uint32_t mesh) const;

private:
    /// Writes sampler.width numbers.
    void read(const MotionSampler& sampler, bool is_rotation, double* out) const;
    [[nodiscard]] std::span<const MotionChannel> channels() const {
        return motion_.channels.subspan(animation_.first_channel, animation_.channel_count);
    }

    const Motion& motion_;
    const MotionAnimation& animation_;
    const double seconds_;
};

}  // namespace raynest
