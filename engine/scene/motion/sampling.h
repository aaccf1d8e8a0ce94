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
    /// Seconds before and behind a moment at which two of these give its velocities. The curves
    /// between keys are smooth: of 30 turns per second that is off by less than a millionth, and
    /// double rounds by less.
    static constexpr double rate_step = 1e-5;

    MotionSampling(const Motion& motion, const MotionAnimation& animation, double seconds)
        : MotionSampling(motion, animation, seconds, seconds) {}
    /// The curves are those between the keys around `keys_at`, also before and behind these.
    MotionSampling(const Motion& motion, const MotionAnimation& animation, double seconds,
                   double keys_at)
        : motion_(motion),
          animation_(animation),
          seconds_(seconds),
          keys_at_(keys_at) {}

    /// Returns the map of each node to the scene.
    [[nodiscard]] std::vector<Affine> nodes() const;
    /// The same as the scene was loaded.
    [[nodiscard]] static std::vector<Affine> nodes_at_rest(const Motion& motion) {
        return MotionSampling(motion, {}, 0).nodes();
    }
    /// Returns the weights of a mesh, by its index.
    [[nodiscard]] std::vector<float> weights(std::uint32_t mesh) const;
    [[nodiscard]] std::vector<double> exact_weights(std::uint32_t mesh) const;

private:
    /// Writes sampler.width numbers.
    void read(const MotionSampler& sampler, bool is_rotation, double* out) const;
    [[nodiscard]] std::span<const MotionChannel> channels() const {
        return motion_.channels.subspan(animation_.first_channel, animation_.channel_count);
    }

    const Motion& motion_;
    const MotionAnimation animation_;
    const double seconds_;
    const double keys_at_;
};

}  // namespace raynest
