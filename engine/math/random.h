// A small random generator with the same numbers on every machine and in every release.
//
// SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014): one
// 64-bit counter and a mixer. Procedural scenes must give the same bytes for the same request, so
// the distributions of <random>, which differ between libraries, are not used.
#pragma once

#include <cstdint>

namespace raynest {

class Random {
public:
    explicit Random(std::uint64_t seed) : state_(seed) {}

    std::uint64_t next() {
        state_ += increment;
        std::uint64_t z = state_;
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
        z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
        return z ^ (z >> 31);
    }

    /// Skips `count` numbers in constant time.
    void skip(std::uint64_t count) { state_ += count * increment; }

    /// Returns a number in [0, 1), 24 bits: every value is exact in a float.
    float uniform() { return static_cast<float>(next() >> 40) * 0x1p-24F; }
    /// Returns a number in [low, high).
    float uniform(float low, float high) { return low + (high - low) * uniform(); }
    /// Returns a number in [0, count); count > 0. The bias of at most count / 2^32 does not matter
    /// to pictures.
    std::uint32_t below(std::uint32_t count) {
        return static_cast<std::uint32_t>(((next() >> 32) * count) >> 32);
    }
    /// Returns an independent generator, so that one part of a scene can grow without moving the
    /// others.
    Random split() { return Random(next()); }

private:
    static constexpr std::uint64_t increment = 0x9E3779B97F4A7C15ULL;
    std::uint64_t state_;
};

}  // namespace raynest
