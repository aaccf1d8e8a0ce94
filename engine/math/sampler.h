// Random numbers of a picture's samples, each computed from its place alone.
//
// The points of a pixel are Owen-scrambled Sobol points (Burley, "Practical Hash-based Owen
// Scrambling", JCGT 2020): pairs of dimensions are the (0,2)-sequence, and each pair of each pixel
// is scrambled and shuffled by a hash of its own. Any first 2^k samples are well distributed, so a
// picture may stop at any count and go on later.
#pragma once

#include "engine/math/vec.h"

#include <cstdint>

namespace raynest {

namespace sampler_detail {

[[nodiscard]] inline std::uint32_t reverse_bits(std::uint32_t x) {
    x = __builtin_bswap32(x);
    x = (x & 0x0F0F0F0FU) << 4 | (x >> 4 & 0x0F0F0F0FU);
    x = (x & 0x33333333U) << 2 | (x >> 2 & 0x33333333U);
    return (x & 0x55555555U) << 1 | (x >> 1 & 0x55555555U);
}

/// Owen scrambling of reversed bits: each bit is flipped by a hash of the bits below it. The
/// constants are those of Vegdahl, "Building a Better LK Hash", 2021.
[[nodiscard]] inline std::uint32_t scramble_reversed(std::uint32_t x, std::uint32_t seed) {
    x ^= x * 0x3D20ADEAU;
    x += seed;
    x *= seed >> 16 | 1U;
    x ^= x * 0x05526C56U;
    x ^= x * 0x53A22864U;
    return x;
}

/// Second dimension of Sobol's sequence, its bits reversed: a product with Pascal's triangle modulo
/// 2, where entry (i, j) is 1 if j has no bit that i lacks (Lucas). So it is a sum over supersets.
[[nodiscard]] inline std::uint32_t sobol_second_reversed(std::uint32_t index) {
    index ^= index >> 1 & 0x55555555U;
    index ^= index >> 2 & 0x33333333U;
    index ^= index >> 4 & 0x0F0F0F0FU;
    index ^= index >> 8 & 0x00FF00FFU;
    return index ^ index >> 16;
}

/// Mixes 64 bits (Steele, Lea and Flood, 2014).
[[nodiscard]] inline std::uint64_t mix(std::uint64_t z) {
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    return z ^ (z >> 31);
}

/// In [0, 1): 24 bits, each value exact in a float.
[[nodiscard]] inline float unit(std::uint32_t x) {
    return static_cast<float>(x >> 8) * 0x1p-24F;
}

}  // namespace sampler_detail

/// The numbers of one sample of one pixel. Cheap to copy and to make anew.
class Sampler {
public:
    Sampler(std::uint64_t seed, std::uint64_t pixel, std::uint32_t sample)
        : key_(sampler_detail::mix(sampler_detail::mix(seed + 0x9E3779B97F4A7C15ULL) ^
                                   (pixel + 1) * 0xD1B54A32D192ED03ULL)),
          reversed_sample_(sampler_detail::reverse_bits(sample)) {}

    /// Two numbers in [0, 1) of dimension `dimension`; another dimension gives independent ones.
    [[nodiscard]] Vec2 pair(std::uint32_t dimension) const {
        using namespace sampler_detail;
        const std::uint64_t first = mix(key_ + dimension * 0x9E3779B97F4A7C15ULL);
        const std::uint64_t second = mix(first ^ 0xA0761D6478BD642FULL);
        const std::uint32_t index =
            reverse_bits(scramble_reversed(reversed_sample_, static_cast<std::uint32_t>(first)));
        // The first dimension of Sobol is the index with its bits reversed.
        const std::uint32_t x =
            reverse_bits(scramble_reversed(index, static_cast<std::uint32_t>(second)));
        const std::uint32_t y = reverse_bits(scramble_reversed(
            sobol_second_reversed(index), static_cast<std::uint32_t>(second >> 32)));
        return {unit(x), unit(y)};
    }
    /// One number in [0, 1), the first of a pair.
    [[nodiscard]] float one(std::uint32_t dimension) const { return pair(dimension).x; }

private:
    std::uint64_t key_;
    std::uint32_t reversed_sample_;
};

/// The dimension of the point in the pixel; integrators use those from sampler_dimensions on.
inline constexpr std::uint32_t pixel_dimension = 0;
inline constexpr std::uint32_t sampler_dimensions = 1;

}  // namespace raynest
