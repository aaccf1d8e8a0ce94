// Guesses are taken where most are right, and left where many are wrong.
#include "engine/bvh/guesses.h"

#include <doctest/doctest.h>

namespace raynest {
namespace {

using Use = TriedGuesses::Use;

/// Traces lots of rays, whose way goes on from child 1 as `next` says; counts the lots by use.
struct Lots {
    TriedGuesses guesses;
    std::uint32_t taken = 0, tried = 0, left = 0;

    template <class Next>
    void trace(std::uint32_t count, Next next) {
        for (std::uint32_t lot = 0; lot < count; ++lot) {
            const Use use = guesses.of_next_lot();
            ++(use == Use::taken ? taken : use == Use::tried ? tried : left);
            for (std::uint32_t step = 0; step < 128; ++step) {
                const std::uint32_t to = next(step);
                if (use == Use::tried) CHECK(guesses.check(1, to) == to);
                if (use == Use::taken) CHECK(static_cast<Guesses&>(guesses).check(1, to) == to);
            }
        }
    }
};

TEST_CASE("guesses that are mostly right are taken, others left until they are right again") {
    // A way that changes at every eighth step makes two guesses wrong.
    const auto seldom = [](std::uint32_t step) { return step % 8 == 0 ? 3U : 2U; };
    const auto always = [](std::uint32_t step) { return step; };
    Lots right;
    right.trace(256, seldom);
    CHECK(right.left == 0);
    CHECK(right.tried < 256 / 8);

    Lots wrong;
    wrong.trace(64, always);
    CHECK(wrong.left > 32);
    CHECK(wrong.tried < 64 / 8);
    wrong.trace(256, seldom);
    const std::uint32_t left = wrong.left;
    wrong.trace(64, seldom);
    CHECK(wrong.left == left);
    wrong.trace(64, always);
    CHECK(wrong.left > left);
}

}  // namespace
}  // namespace raynest
