// A material is a type that tells how light scatters at a point of a surface. Directions are unit
// vectors in the point's frame: +z is the shading normal, on the side that the ray came from.
//
//     struct Standard {
//         explicit Standard(const MaterialPoint& point, const Vec3& outgoing);
//         static constexpr bool lights_others;         // false: emitted() is for viewers alone
//         Vec3 emitted() const;                        // radiance towards `outgoing`
//         bool scatters() const;                       // false: the three below are not called
//         Vec3 evaluate(const Vec3& incoming) const;   // BSDF x |cosine of incoming|
//         float density(const Vec3& incoming) const;   // density of sample(), per solid angle
//         Vec3 sample(float choice, const Vec2& u) const;  // a direction; zero where there is none
//         Scattered scatter(const Vec3& incoming) const;   // may be left out: both of the above
//     };
//
// A new material is one header and one row in materials.def. Its values come from the same members of
// glTF; `extras.raynest.material` in a glTF material names it.
#pragma once

#include "engine/math/vec.h"
#include "engine/shading/records.h"

#include <concepts>

namespace raynest {

/// A material at a point, by its textures and factors.
struct MaterialPoint {
    Vec3 base_colour{1};
    Vec3 emission{0};
    float metallic = 0;
    float roughness = 1;
    float ior = 1.5F;
    float transmission = 0;
    bool solid = false;    ///< light is refracted at the surface; else it is a sheet
    bool inside = false;   ///< the ray came from within a solid
    Vec3 smooth{0, 0, 1};  ///< the normal without the normal texture, in the point's frame
    /// Set where the material is `layered`.
    Layers layers;
    float film_thickness = 400;  ///< the iridescent film's, in nanometres
    Vec3 coat_normal{0, 0, 1};   ///< the clear coat's, in the point's frame
    Vec2 along{1, 0};            ///< the direction of anisotropy, a unit vector in the frame's xy
};

/// Share of the light from a direction that the bumps of a normal texture leave a diffuse base: it
/// falls to 0 at the horizon of MaterialPoint::smooth, where bumps shadow each other. Without it
/// walls that light grazes reflect too much. 1 without bumps (Conty Estevez, Lecocq and Stein, "A
/// Microfacet-Based Shadowing Function to Solve the Bump Terminator Problem", Ray Tracing Gems,
/// 2019; Cycles' polynomial).
[[nodiscard]] inline float lit_share(const Vec3& smooth, const Vec3& incoming) {
    const float cosines = incoming.z * smooth.z;
    const float g = cosines > 0 ? glm::dot(incoming, smooth) / cosines : 0.0F;
    if (g >= 1) return 1;
    return g > 0 ? g * (1.0F + g - g * g) : 0.0F;
}

/// What Material::evaluate() and density() say of one direction.
struct Scattered {
    Vec3 value{0};
    float density = 0;
};

template <class M>
concept MaterialLike = requires(const M& m, const MaterialPoint& point, const Vec3& v, float x,
                                const Vec2& u) {
    M(point, v);
    { M::lights_others } -> std::convertible_to<bool>;
    { m.emitted() } -> std::same_as<Vec3>;
    { m.scatters() } -> std::same_as<bool>;
    { m.evaluate(v) } -> std::same_as<Vec3>;
    { m.density(v) } -> std::same_as<float>;
    { m.sample(x, u) } -> std::same_as<Vec3>;
};

/// Both at once, where a material shares the work.
template <MaterialLike M>
[[nodiscard]] Scattered scatter(const M& material, const Vec3& incoming) {
    if constexpr (requires { material.scatter(incoming); })
        return material.scatter(incoming);
    else
        return {material.evaluate(incoming), material.density(incoming)};
}

}  // namespace raynest
