// How fast the parts of a scene move.
#pragma once

#include "engine/result.h"
#include "engine/scene/edits/pose.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

namespace raynest {

class SpeedMeter;

/// Finds the speed, in the scene's units per second, that nothing exceeds between two moments of an
/// animation: that of the corners of what moves, found at each key and several times between.
/// Jumps have no speed: jumps_between() tells them. Not thread-safe.
class SpeedSearch {
public:
    /// Keys between the two moments, at most; and how often a node or a corner is looked at.
    static constexpr std::uint64_t keys_max = 1 << 16;
    static constexpr std::uint64_t looks_max = 1ULL << 30;

    /// The scene, which outlives this, has the animation. Looks at each vertex that moves. Fails with
    /// limit_exceeded. Throws std::bad_alloc.
    static Result<SpeedSearch> begin(const Snapshot& scene, std::uint32_t animation, double from,
                                     double to);
    SpeedSearch(SpeedSearch&&) noexcept;
    SpeedSearch& operator=(SpeedSearch&&) noexcept;
    ~SpeedSearch();

    /// Goes on until `pause` is true, which it asks after each look at all that moves. Returns true
    /// once the speed is found.
    bool go_on(const std::function<bool()>& pause);
    /// Infinite where it overflows.
    [[nodiscard]] double fastest() const;

private:
    explicit SpeedSearch(std::unique_ptr<SpeedMeter> meter);
    std::unique_ptr<SpeedMeter> meter_;
};

/// Returns when parts jump, from `from` on, without it, to `to`: at the keys of STEP channels that have
/// another value than the one before. Ascending, each once. Fails with limit_exceeded beyond
/// SpeedSearch::keys_max. Throws std::bad_alloc.
Result<std::vector<double>> jumps_between(const Snapshot& scene, std::uint32_t animation,
                                          double from, double to);

}  // namespace raynest
