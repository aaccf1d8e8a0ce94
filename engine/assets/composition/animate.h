// The animations of a composition as tables of a scene.
#pragma once

#include "engine/assets/composition/read.h"

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace raynest::composition {

/// Knows which outermost instances stand under which name.
class Animator {
public:
    /// The next `count` outermost instances are those of `places`; `to_group` leads from their
    /// object's coordinates to those that are placed.
    void add(const Places& places, std::size_t count, const Matrix& to_group);
    /// Makes the tables (motion/motion.h). Fails with scene_invalid for a channel of an instance that
    /// is not there, or that a matrix places, and with limit_exceeded beyond the limits of tables.
    [[nodiscard]] Result<std::vector<std::byte>> tables(const std::vector<Animation>& animations,
                                                        const WorldPoint& origin) const;

private:
    struct Place {
        std::uint32_t outermost = 0;
        bool is_moving = false;  ///< it can be
        PoseParts parts;
        Matrix to_group{1};
    };
    /// Returns the place that a channel means.
    [[nodiscard]] Result<const Place*> find(const Channel& channel) const;

    std::map<std::string, std::vector<Place>> places_;  ///< by name
    std::uint32_t count_ = 0;
};

}  // namespace raynest::composition
