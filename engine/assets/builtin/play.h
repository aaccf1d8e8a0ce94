// The animation of a built-in scene: outermost instances and cameras that follow nodes with keys.
#pragma once

#include "engine/math/vec.h"
#include "engine/scene/motion/motion.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace raynest {

class Play {
public:
    explicit Play(float seconds) : seconds_(seconds) {}

    /// Adds a node that goes straight from zero to `way` in the whole time, and returns its number.
    std::uint32_t add_drive(const Vec3& way);
    /// Adds a node at `foot` that rocks about an axis, a unit vector, by `angle` radians at most,
    /// once in `period` seconds; `phase` is 0 to 1.
    std::uint32_t add_sway(const Vec3& foot, const Vec3& axis, float angle, float period,
                           float phase);
    /// An instance of the root follows a node; `rest` places it while the node is at zero.
    void follow(std::uint32_t node, std::uint32_t outermost, const Transform& rest);
    void follow_with_camera(std::uint32_t node, std::uint32_t camera, const Transform& rest);

    [[nodiscard]] std::vector<std::byte> bytes();

private:
    std::uint32_t add_floats(const std::vector<float>& values);
    std::uint32_t add_node();
    void add_channel(std::uint32_t node, MotionPath path, const std::vector<float>& times,
                     const std::vector<float>& values);

    const float seconds_;
    MotionTables tables_;
};

}  // namespace raynest
