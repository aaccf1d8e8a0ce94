// How a search learns that nobody waits for its answers any more.
//
// A chunk of rays is no bound in time: one ray may meet everything that a scene holds, from so far
// away that its rounding is larger than the scene, or with a direction too short to be divided by.
// So the caller is asked, each time that a certain amount of work may have been done: before rays
// and instances, whose trees may be met as a whole, at rounds of a stream, at leaves of a packet.
// Within one tree a single ray is not interrupted: a question at each leaf costs any hits 2 %
// (measured; where they are, nothing), and a tree ends, where instances of instances are as good as
// endless.
#pragma once

#include "engine/geometry/views.h"

#include <cstdint>

namespace raynest {

/// Of one call of a kernel, on one thread. Work is counted in leaf blocks: up to 100 ns each, of
/// large trees (measured: 8.4 million triangles met by one ray in 70 to 130 ms).
class Cancellation {
public:
    using Asked = bool (*)(const void* context) noexcept;
    /// `asked` may be null: nobody cancels.
    Cancellation(Asked asked, const void* context) : asked_(asked), context_(context) {}

    /// So much work lies ahead, at most. True from where the caller was found to have cancelled.
    RAYNEST_INLINE bool before(std::int64_t work) {
        left_ -= work;
        if (left_ >= 0) [[likely]]
            return false;
        return look();
    }
    [[nodiscard]] bool was_seen() const { return seen_; }

private:
    /// A dozen milliseconds at most; some microseconds where rays meet what they are meant to.
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

/// Of a ray in one tree: all of its blocks and records. The least is more, what it takes to get
/// there; 32 small trees are worth a question.
[[nodiscard]] RAYNEST_INLINE std::int64_t work_in(const ObjectRecord& object) {
    constexpr std::int64_t small = 1 << 12;
    return small + object.block_count + object.record_count;
}

/// Whether a search that may be cancelled was, before so much work; by nobody where the pointer is
/// null.
RAYNEST_INLINE bool is_cancelled(Cancellation* cancellation, std::int64_t work) {
    return cancellation != nullptr && cancellation->before(work);
}

}  // namespace raynest
