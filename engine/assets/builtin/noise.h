// Value noise: smooth random heights without a table, for terrain, bark and ground.
#pragma once

#include "engine/math/random.h"

#include <cmath>
#include <cstdint>

namespace raynest {

/// Returns one octave in [0, 1]; `period` > 0 repeats it, for textures that tile.
inline float value_noise(float x, float y, std::uint32_t period, std::uint64_t seed) {
    const auto lattice = [&](std::int64_t i, std::int64_t j) {
        if (period != 0) {
            const auto p = static_cast<std::int64_t>(period);
            i = ((i % p) + p) % p;
            j = ((j % p) + p) % p;
        }
        const auto key = static_cast<std::uint64_t>(i) * 0x8DA6B343U +
                         static_cast<std::uint64_t>(j) * 0xD8163841U;
        return Random(seed ^ key).uniform();
    };
    const float fx = std::floor(x);
    const float fy = std::floor(y);
    const auto i = static_cast<std::int64_t>(fx);
    const auto j = static_cast<std::int64_t>(fy);
    const auto smooth = [](float t) { return t * t * (3 - 2 * t); };
    const float u = smooth(x - fx);
    const float v = smooth(y - fy);
    const float low = lattice(i, j) + u * (lattice(i + 1, j) - lattice(i, j));
    const float high = lattice(i, j + 1) + u * (lattice(i + 1, j + 1) - lattice(i, j + 1));
    return low + v * (high - low);
}

/// Returns a sum of octaves, each twice as fine and half as strong; in [0, 1].
inline float fractal_noise(float x, float y, int octaves, std::uint32_t period,
                           std::uint64_t seed) {
    float sum = 0;
    float weight = 0.5F;
    float total = 0;
    for (int octave = 0; octave < octaves; ++octave) {
        sum += weight * value_noise(x, y, period, seed + static_cast<std::uint64_t>(octave));
        total += weight;
        weight *= 0.5F;
        x *= 2;
        y *= 2;
        period *= 2;
    }
    return sum / total;
}

}  // namespace raynest
