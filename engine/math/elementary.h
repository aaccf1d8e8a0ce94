// Sine, cosine, arc functions, logarithm and power in float, of plain additions and multiplications: the
// same bits on every CPU and in every C library, and no calls.
#pragma once

#include "engine/math/vec.h"

#include <bit>
#include <cmath>
#include <cstdint>
#include <numbers>

namespace raynest {

/// Cosine and sine of 2 pi u, for u in [0, 1]; within 3e-7.
[[nodiscard]] inline Vec2 circle(float u) {
    // In quarters of a turn, the angle from the nearest axis is at most an eighth.
    const float quarters = 4.0F * u;
    const int nearest = static_cast<int>(quarters + 0.5F);
    const float x = (quarters - static_cast<float>(nearest)) * (std::numbers::pi_v<float> / 2);
    const float x2 = x * x;
    const float s =
        x + x * x2 * (-1.6666654611e-1F + x2 * (8.3321608736e-3F + x2 * -1.9515295891e-4F));
    const float c =
        1.0F - 0.5F * x2 +
        x2 * x2 *
            (4.166664568298827e-2F + x2 * (-1.388731625493765e-3F + x2 * 2.443315711809948e-5F));
    const float along = (nearest & 1) != 0 ? s : c;
    const float across = (nearest & 1) != 0 ? c : s;
    return {((nearest + 1) & 2) != 0 ? -along : along, (nearest & 2) != 0 ? -across : across};
}

/// Arc tangent of y / x in all four quadrants, in (-pi, pi]; within 4e-7. (0, 0) gives 0.
[[nodiscard]] inline float arc_tangent(float y, float x) {
    const float ax = std::abs(x);
    const float ay = std::abs(y);
    const float larger = std::max(ax, ay);
    if (!(larger > 0)) return 0;
    const float q = std::min(ax, ay) / larger;
    const float q2 = q * q;
    // Abramowitz and Stegun, 4.4.49.
    float a =
        q * (1.0F +
             q2 * (-0.3333314528F +
                   q2 * (0.1999355085F +
                         q2 * (-0.1420889944F +
                               q2 * (0.1065626393F +
                                     q2 * (-0.0752896400F +
                                           q2 * (0.0429096138F +
                                                 q2 * (-0.0161657367F + q2 * 0.0028662257F))))))));
    if (ay > ax) a = std::numbers::pi_v<float> / 2 - a;
    if (x < 0) a = std::numbers::pi_v<float> - a;
    return std::copysign(a, y);
}

/// Arc cosine of x, clamped to [-1, 1]; within 5e-7.
[[nodiscard]] inline float arc_cosine(float x) {
    const float a = std::min(std::abs(x), 1.0F);
    // Abramowitz and Stegun, 4.4.46.
    const float rest =
        1.5707963050F +
        a * (-0.2145988016F +
             a * (0.0889789874F +
                  a * (-0.0501743046F +
                       a * (0.0308918810F +
                            a * (-0.0170881256F + a * (0.0066700901F + a * -0.0012624911F))))));
    const float angle = std::sqrt(1.0F - a) * rest;
    return x < 0 ? std::numbers::pi_v<float> - angle : angle;
}

/// Binary logarithm of a positive, normal number; within 2e-05.
[[nodiscard]] inline float rough_log2(float x) {
    const auto bits = std::bit_cast<std::uint32_t>(x);
    const auto exponent = static_cast<float>(static_cast<int>(bits >> 23) - 127);
    // The mantissa m in [1, 2): minimax over the interval, exact at 1 and 2.
    const float m = std::bit_cast<float>((bits & 0x007FFFFFU) | 0x3F800000U) - 1.0F;
    const float part =
        m *
        (1.4419169F + m * (-0.7090957F + m * (0.4156041F + m * (-0.1935737F + m * 0.0451483F))));
    return exponent + part;
}

/// 2 to the power of x, clamped to [-126, 126]; its relative error is below 1e-6.
[[nodiscard]] inline float rough_exp2(float x) {
    const float clamped = std::min(std::max(x, -126.0F), 126.0F);
    const float whole = std::floor(clamped + 0.5F);
    const float f = (clamped - whole) * std::numbers::ln2_v<float>;
    const float part =
        1.0F + f * (1.0F + f * (0.5F + f * (1.0F / 6 + f * (1.0F / 24 + f * (1.0F / 120)))));
    const auto exponent = static_cast<std::uint32_t>(static_cast<int>(whole) + 127);
    return part * std::bit_cast<float>(exponent << 23);
}

}  // namespace raynest
