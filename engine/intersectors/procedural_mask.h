// The paper's second use case: a mask computed from the texture coordinates, no image needed.
#pragma once

#include "engine/intersectors/interface.h"
#include "engine/intersectors/texture.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <tuple>

namespace raynest {

/// Cuts a pattern into surfaces, on TEXCOORD_0 where there is one, else on the hit's (u, v).
/// Only +, -, *, /, sqrt, floor and comparisons: the same bits on every target.
struct ProceduralMask {
    static constexpr const char* text = "a computed pattern cuts holes, on TEXCOORD_0 or (u, v)";
    enum class Pattern : std::uint32_t { heart, checker, discs, noise };
    enum class On : std::uint32_t { masked, all };
    static constexpr std::array<const char*, 4> patterns{"heart", "checker", "discs", "noise"};
    static constexpr std::array<const char*, 2> targets{"masked", "all"};
    struct Params {
        Pattern pattern = Pattern::discs;
        float scale = 4;
        float fill = 0.5F;
        std::uint32_t seed = 1;
        On on = On::masked;
    };
    static constexpr auto params = std::tuple{
        param("pattern", &Params::pattern, patterns, "shape that stays solid"),
        param("scale", &Params::scale, 1e-3F, 1e6F, "cells per unit of u and v"),
        param("fill", &Params::fill, 0.0F, 1.0F, "share of the surface that is solid"),
        param("seed", &Params::seed, 0U, 0xFFFFFFFFU, "of pattern=noise"),
        param(
            "on", &Params::on, targets,
            "materials that are cut: MASK and BLEND ones (all, when the scene has none), or all")};

    RAYNEST_FN ProceduralMask(const SceneView& view, const Params& values)
        : scene(view),
          p(values),
          everywhere(values.on == On::all || view.masked_materials == 0),
          size(size_of(values.pattern, values.fill > largest_share(values.pattern)
                                           ? 1.0F - values.fill
                                           : values.fill)) {}

    RAYNEST_FN auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto hits = intersect(ray, triangle);
        hits.keep_if([&](const Surface& surface) {
            return ray.object == nullptr || is_solid(*ray.object, surface);
        });
        return hits;
    }

    [[nodiscard]] static Refusal refusal(const RayView& /*ray*/, const Surface& /*surface*/) {
        return {"in a hole of the pattern"};
    }

private:
    [[nodiscard]] RAYNEST_FN bool is_solid(const ObjectRecord& object,
                                           const Surface& surface) const {
        const GeometryRecord& geometry = scene.geometry_of(object, surface.prim);
        if (!everywhere && (geometry.material == no_id ||
                            scene.materials[geometry.material].alpha_mode == AlphaMode::opaque)) {
            return true;
        }
        const Vec2 st = texture_coordinates(scene, geometry, 0, surface.prim, surface.u, surface.v);
        const float x = st.x * p.scale;
        const float y = st.y * p.scale;
        const float column = std::floor(x);
        const float row = std::floor(y);
        return is_solid_at(x - column, y - row, column, row);
    }

    // (x, y) in [0, 1): the place in the cell. Each pattern is one shape of a given `size`, which
    // is the solid or, where `inverted`, the hole.
    [[nodiscard]] RAYNEST_FN bool is_solid_at(float x, float y, float column, float row) const {
        const bool inverted = p.fill > largest_share(p.pattern);
        switch (p.pattern) {
            case Pattern::heart: {
                // (a^2 + b^2 - 1)^3 < a^2 b^3, the usual heart curve; t points down in glTF. A
                // size of infinity makes a and b infinite or NaN: nothing is inside.
                const float a = (x - 0.5F) * size;
                const float b = (0.55F - y) * size;
                const float r = fused(a, a, fused(b, b, -1.0F));
                return (r * r * r < a * a * (b * b * b)) != inverted;
            }
            case Pattern::checker: {
                // Two of the cell's four quarters; with a smaller share, the middle of each.
                const bool left = x < 0.5F;
                const bool top = y < 0.5F;
                const float a = x - (left ? 0.25F : 0.75F);
                const float b = y - (top ? 0.25F : 0.75F);
                const float reach = 8.0F * (a * a > b * b ? a * a : b * b);
                return ((left == top) != inverted && reach < size) != inverted;
            }
            case Pattern::discs: {
                // A disc in the middle of the cell, or a hole around its corners.
                const float centre = inverted ? 0.5F : 0.0F;
                const float a = centre - std::abs(x - 0.5F);
                const float b = centre - std::abs(y - 0.5F);
                return (fused(a, a, b * b) < size) != inverted;
            }
            case Pattern::noise:
                return hash(column, row) < size;
        }
        return true;
    }

    // A number in [0, 1) per cell. Columns and rows wrap at 2^20, so that no conversion overflows;
    // infinite ones, of coordinates near the end of what floats hold, are the first.
    [[nodiscard]] RAYNEST_FN float hash(float column, float row) const {
        const auto wrap = [](float cell) {
            const float wrapped = cell - 1048576.0F * std::floor(cell / 1048576.0F);
            return wrapped >= 0.0F ? static_cast<std::uint32_t>(wrapped) : 0U;
        };
        std::uint32_t h = wrap(column) * 0x9E3779B1U ^ wrap(row) * 0x85EBCA77U ^ p.seed;
        h = (h ^ h >> 15) * 0x2C1B3C6DU;
        h = (h ^ h >> 12) * 0x297A2D39U;
        return static_cast<float>((h ^ h >> 15) >> 8) * 0x1p-24F;
    }

    /// The largest share of a cell that a pattern's shape can cover; above it the hole has that
    /// shape.
    [[nodiscard]] RAYNEST_FN static float largest_share(Pattern pattern) {
        switch (pattern) {
            case Pattern::heart:
                return 0.7F;
            case Pattern::checker:
                return 0.5F;
            case Pattern::discs:
                return 0.78539816F;  // pi / 4
            case Pattern::noise:
                return 1.0F;
        }
        return 1.0F;
    }

    /// The number that is_solid_at() compares with, for a shape that covers this share of a cell.
    [[nodiscard]] RAYNEST_FN static float size_of(Pattern pattern, float share) {
        switch (pattern) {
            case Pattern::heart:
                return std::sqrt(3.66197F / share);  // units per cell; the curve's area over it
            case Pattern::checker:
                return share < 0.5F ? share : 1.0F;
            case Pattern::discs:
                return share / 3.14159265F;  // squared radius
            case Pattern::noise:
                return share;
        }
        return share;
    }

    const SceneView& scene;
    Params p;
    bool everywhere;
    float size;
};

}  // namespace raynest
