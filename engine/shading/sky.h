// A clear sky by day: Preetham, Shirley and Smits, "A Practical Analytic Model for Daylight"
// (1999).
#pragma once

#include "engine/shading/environment.h"

namespace raynest {

/// A disc at infinity.
struct SunDisc {
    Vec3 direction{0, 1, 0};  ///< towards it
    Vec3 radiance{0};         ///< black: there is none
    float cosine = 1;         ///< cosine of its angular radius

    [[nodiscard]] float density() const { return 1.0F / (2.0F * pi * (1.0F - cosine)); }
    [[nodiscard]] bool contains(const Vec3& direction_of) const {
        // Not by the angle's cosine: that has few digits so close to 1.
        const Vec3 apart = direction_of - direction;
        return glm::dot(apart, apart) <= 2.0F * (1.0F - cosine);
    }
    [[nodiscard]] Vec3 sample(const Vec2& u) const {
        const float below = u.x * (1.0F - cosine);  // 1 less the cosine
        const float s = std::sqrt(below * (2.0F - below));
        return glm::normalize(
            basis_around(direction).to_world(Vec3(s * circle(u.y), 1.0F - below)));
    }
};

struct Sky {
    Environment environment;
    SunDisc sun;
};

/// The sky with the sun at an azimuth from -Z towards +X and an elevation, in degrees. The ground
/// below the horizon reflects a fifth of the light. Physical in its proportions; as a whole it is
/// scaled, so that a white surface that faces a high sun has a radiance near 1, as glTF's
/// lights and emission are made for.
[[nodiscard]] Sky make_sky(float azimuth_degrees, float elevation_degrees);

}  // namespace raynest
