// Guesses at the way of a ray that is like the one before it.
#pragma once

#include "engine/math/vec.h"

#include <cstdint>

namespace raynest {

/// For each child, the one that a ray looked at after it: a guess at what a ray like that will.
///
/// A CPU that has found guesses right goes on with one while the box test that the truth follows
/// from is still under way (measured: tests/bench/BENCH.md).
class Guesses {
public:
    /// Returns `next`.
    RAYNEST_INLINE std::uint32_t check(std::uint32_t child, std::uint32_t next) {
        std::uint32_t& kept = after(child);
        std::uint32_t guess = kept;
        if (guess == next) [[likely]] {
            // Not to be replaced by `next`, for which the CPU would wait.
            asm volatile("" : "+r"(guess));
            return guess;
        }
        kept = next;
        return next;
    }

protected:
    RAYNEST_INLINE std::uint32_t& after(std::uint32_t child) {
        return next_[(child ^ child >> 4) % size];
    }

private:
    static constexpr std::uint32_t size = 128;
    std::uint32_t next_[size]{};
};

/// Guesses that count how many are wrong, and say whether the next rays should take them.
///
/// Where neighbours seldom hit the same triangle, guesses delay more than they hasten: in soups of
/// triangles 0.39 to 0.58 of them are wrong, in terrain, cards and interior 0.17 to 0.19. To count
/// takes 4 to 8 % of the time of camera rays, so a few lots of rays do it for many.
class TriedGuesses : public Guesses {
public:
    enum class Use { taken, tried, left };

    /// Says how the next lot of rays uses them. Some make them anew before others try them.
    RAYNEST_INLINE Use of_next_lot() {
        const std::uint32_t lot = lots_++ % lots_per_try;
        if (lot == 0) asked_ /= 2, wrong_ /= 2;
        if (lot < lots_before) return Use::taken;
        if (lot < lots_before + lots_tried) return Use::tried;
        return wrong_ * 3 < asked_ ? Use::taken : Use::left;
    }

    /// Returns `next`.
    RAYNEST_INLINE std::uint32_t check(std::uint32_t child, std::uint32_t next) {
        ++asked_;
        if (after(child) != next) ++wrong_;
        return Guesses::check(child, next);
    }

private:
    static constexpr std::uint32_t lots_per_try = 64;
    static constexpr std::uint32_t lots_before = 3;
    static constexpr std::uint32_t lots_tried = 4;
    std::uint32_t lots_ = 0;
    // As if some had been right before: a few rays say little.
    std::uint32_t asked_ = 512;
    std::uint32_t wrong_ = 102;
};

}  // namespace raynest
