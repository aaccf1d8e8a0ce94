#include "engine/shading/iridescence.h"

#include "engine/shading/standard.h"

namespace raynest {
namespace {

float cosine_of(float radians) {
    const float turns = radians / (2 * pi);
    return circle(std::min(turns - std::floor(turns), one_below)).x;
}

float squared(float x) {
    return x * x;
}

/// The colour that the eye makes of the interference of two waves, in XYZ: Fourier transforms of its
/// sensitivities, each a Gaussian, X the sum of two. `distance` in nanometres.
Vec3 seen_interference(float distance, const Vec3& shift) {
    const float phase = 2 * pi * distance * 1e-9F;
    constexpr float log2_e = 1.44269504F;
    const auto wave = [&](float value, float position, float variance, float by) {
        return value * std::sqrt(2 * pi * variance) * cosine_of(position * phase + by) *
               rough_exp2(-log2_e * variance * phase * phase);
    };
    const Vec3 xyz = Vec3(wave(5.4856e-13F, 1.6810e6F, 4.3278e9F, shift.x) +
                              wave(9.7470e-14F, 2.2399e6F, 4.5282e9F, shift.x),
                          wave(4.4201e-13F, 1.7953e6F, 9.3046e9F, shift.y),
                          wave(5.2481e-13F, 2.2084e6F, 6.6121e9F, shift.z)) /
                     1.0685e-7F;
    return {3.2404542F * xyz.x - 1.5371385F * xyz.y - 0.4985314F * xyz.z,
            -0.9692660F * xyz.x + 1.8760108F * xyz.y + 0.0415560F * xyz.z,
            0.0556434F * xyz.x - 0.2040259F * xyz.y + 1.0572252F * xyz.z};
}

}  // namespace

Vec3 iridescent_f0(float cosine, float film_ior, float thickness, const Vec3& f0) {
    // A film that vanishes has the index of air.
    const float there = std::clamp(thickness / 0.03F, 0.0F, 1.0F);
    const float ior = 1.0F + (film_ior - 1.0F) * there * there * (3.0F - 2.0F * there);
    const float cosine2 = 1.0F - (1.0F - cosine * cosine) / (ior * ior);
    if (cosine2 < 0) return Vec3(1);
    const float within = std::sqrt(cosine2);

    const float outer = schlick(Vec3(border_reflectance(ior)), cosine).x;
    const float through = 1.0F - outer;
    const float outer_shift = ior < 1 ? 0.0F : pi;  // for the reflection from within
    Vec3 inner, shift;
    for (int c = 0; c < 3; ++c) {
        const float root = std::sqrt(std::clamp(f0[c], 0.0F, 0.9999F));
        const float base_ior = (1.0F + root) / (1.0F - root);
        inner[c] = schlick(Vec3(border_reflectance(base_ior / ior)), within).x;
        shift[c] = outer_shift + (base_ior < ior ? pi : 0.0F);
    }
    const float distance = 2.0F * ior * thickness * within;

    Vec3 sum, amplitude, both;
    for (int c = 0; c < 3; ++c) {
        const float product = std::clamp(outer * inner[c], 1e-5F, 0.9999F);
        both[c] = std::sqrt(product);
        const float reflected = squared(through) * inner[c] / (1.0F - product);
        sum[c] = outer + reflected;
        amplitude[c] = reflected - through;
    }
    for (int m = 1; m <= 2; ++m) {
        amplitude *= both;
        const auto order = static_cast<float>(m);
        sum += amplitude * 2.0F * seen_interference(order * distance, order * shift);
    }
    const float grazing = std::min(schlick_weight(cosine), 0.9999F);
    Vec3 made;
    for (int c = 0; c < 3; ++c)
        made[c] = std::clamp((sum[c] - grazing) / (1.0F - grazing), 0.0F, 1.0F);
    return made;
}

}  // namespace raynest
