// How a search learns that nobody waits for its answers any more.
//
// A chunk of rays is no bound in time: one ray may meet everything that a scene holds, from so far
// away that its rounding is larger than the scene, or with a direction too short to be divided by.
// So it is looked for between rays, at each instance that is entered, and at each round of a batch
// or leaf of a packet. Within one tree a ray is not interrupted: a look at each of its leaves costs
// any hits 2 % (measured; where it is, nothing), and a tree ends, where instances of instances are
// as good as endless.
#pragma once

#include "engine/math/vec.h"

#include <cstdint>

namespace raynest {

/// Of one call of a kernel, on one thread.
class Cancellation {
public:
    using Asked = bool (*)(const void* context) noexcept;
    /// `asked` may be null: nobody cancels.
    Cancellation(Asked asked, const void* context) : asked_(asked), context_(context) {}

    /// A small step of the search; asks at some of them. True from where the answer was yes.
    RAYNEST_INLINE bool step() {
        if (--steps_left_ != 0) [[likely]]
            return false;
        return look();
    }
    /// Asks now.
    RAYNEST_NOINLINE bool look() {
        seen_ = seen_ || (asked_ != nullptr && asked_(context_));
        steps_left_ = seen_ ? 1 : steps_between_looks;
        return seen_;
    }
    [[nodiscard]] bool was_seen() const { return seen_; }

private:
    static constexpr std::uint32_t steps_between_looks = 32;

    const Asked asked_;
    const void* const context_;
    std::uint32_t steps_left_ = steps_between_looks;
    bool seen_ = false;
};

/// A step of a search that may be cancelled; by nobody where the pointer is null.
RAYNEST_INLINE bool is_cancelled(Cancellation* cancellation) {
    return cancellation != nullptr && cancellation->step();
}

}  // namespace raynest
