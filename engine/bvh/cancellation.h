// Cancels a search when its answers are no longer wanted.
//
// A chunk of rays has no bound in time: a single ray may visit the whole scene, if it starts so far
// away that its rounding error exceeds the scene, or if its direction is too short to divide by.
// Kernels therefore check for cancellation whenever a certain amount of work may have passed:
// before rays and instances, which may visit a whole tree, at rounds of a stream, at leaves of a
// packet. A single ray is not interrupted within one tree: a check at each leaf costs any-hit
// queries 2 % (measured; the present checks cost nothing). A tree is finite, whereas nested
// instances are practically endless.
#pragma once

#include "engine/geometry/views.h"

#include <cstdint>

namespace raynest {

/// The check for one call of a kernel, on one thread. Work is counted in leaf blocks, which take up
/// to 100 ns each in large trees (measured: one ray visits 8.4 million triangles in 70 to 130 ms).
class Cancellation {
public:
    using Asked = bool (*)(const void* context) noexcept;
    /// `asked` may be null: the call cannot be cancelled.
    Cancellation(Asked asked, const void* context) : asked_(asked), context_(context) {}

    /// Announces at most this much work. Returns true once the caller was found to have cancelled.
    RAYNEST_INLINE bool before(std::int64_t work) {
        left_ -= work;
        if (left_ >= 0) [[likely]]
            return false;
        return look();
    }
    [[nodiscard]] bool was_seen() const { return seen_; }

private:
    /// Work between two checks: at most a dozen milliseconds, microseconds for ordinary rays.
    static constexpr std::int64_t work_between_looks = 1 << 17;

    RAYNEST_NOINLINE bool look() {
        seen_ = seen_ || (asked_ != nullptr && asked_(context_));
        left_ = seen_ ? -1 : work_between_looks;
        return seen_;
    }

    const Asked asked_;
    const void* const context_;
    std::int64_t left_ = 0;
    bool seen_ = false;
};

/// Returns the maximum work of a ray in one tree: all blocks and records, plus a constant for
/// entering it, which makes 32 small trees worth a check.
[[nodiscard]] RAYNEST_INLINE std::int64_t work_in(const ObjectRecord& object) {
    constexpr std::int64_t small = 1 << 12;
    return small + object.block_count + object.record_count;
}

/// Announces work and returns true if the search was cancelled; a null pointer means that it cannot
/// be.
RAYNEST_INLINE bool is_cancelled(Cancellation* cancellation, std::int64_t work) {
    return cancellation != nullptr && cancellation->before(work);
}

}  // namespace raynest
