// A light of a file is a type without state; its numbers are in a LightRecord.
//
//     struct PointLight {
//         static constexpr bool distant = false;             // true: far from all of the scene
//         static float power(const LightRecord& light);      // in proportion to what it sends out
//         static LightSample sample(const LightRecord& light, const Vec3& from, const Vec2& u);
//     };
//
// If it has `static constexpr std::array numbers{LightNumber{"name", otherwise, least, most}, ...}`,
// LightRecord::own holds those, in this order. A new light is one header and one row in lights.def.
// A file names it by `extras.raynest.light` in a light of KHR_lights_punctual, and its numbers
// beside that.
#pragma once

#include "engine/shading/records.h"
#include "engine/shading/sampling.h"

#include <concepts>
#include <limits>

namespace raynest {

/// A number that lights of one kind have for themselves.
struct LightNumber {
    const char* name;
    float otherwise, least, most;
};

/// A direction in which a point sees a light.
struct LightSample {
    Vec3 direction{0};  ///< unit vector, towards the light
    float distance = std::numeric_limits<float>::infinity();
    Vec3 radiance{0};         ///< what arrives without anything between; black: nothing to trace
    float density = 0;        ///< per solid angle; 1 for a light that has one direction only
    bool can_be_met = false;  ///< a ray that goes there by chance sees the same radiance
    /// The light's point, lifted from its surface, where it has one: end the shadow ray there.
    glm::dvec3 end{0};
    bool ends = false;
};

template <class L>
concept LightLike = requires(const LightRecord& light, const Vec3& from, const Vec2& u) {
    { L::distant } -> std::convertible_to<bool>;
    { L::power(light) } -> std::same_as<float>;
    { L::sample(light, from, u) } -> std::same_as<LightSample>;
};

}  // namespace raynest
