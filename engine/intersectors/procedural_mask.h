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
/// Only +, -, *, floor and comparisons: the same bits on every target.
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
        param("fill", &Params::fill, 0.0F, 1.0F, "share of each cell that is solid, roughly"),
        param("seed", &Params::seed, 0U, 0xFFFFFFFFU, "of pattern=noise"),
        param(
            "on", &Params::on, targets,
            "materials that are cut: MASK and BLEND ones (all, when the scene has none), or all")};

    RAYNEST_FN ProceduralMask(const SceneView& view, const Params& values)
        : scene(view),
          p(values),
          everywhere(values.on == On::all || view.masked_materials == 0) {}

    RAYNEST_FN auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto hits = intersect(ray, triangle);
        hits.keep_if([&](const Surface& surface) {
            return ray.object == nullptr || is_solid(*ray.object, surface);
        });
        return hits;
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
        return inside_cell(x - column, y - row, column, row);
    }

    // (x, y) in [0, 1): the place in the cell.
    [[nodiscard]] RAYNEST_FN bool inside_cell(float x, float y, float column, float row) const {
        switch (p.pattern) {
            case Pattern::heart: {
                // (a^2 + b^2 - 1)^3 < a^2 b^3, the usual heart curve, about 1.2 wide; t points down
                // in glTF.
                const float size = 0.25F + p.fill;
                const float a = (x - 0.5F) * 2.6F / size;
                const float b = (0.55F - y) * 2.6F / size;
                const float r = fused(a, a, fused(b, b, -1.0F));
                return r * r * r < a * a * (b * b * b);
            }
            case Pattern::checker: {
                const float corner = p.fill;
                const bool left = x < corner;
                const bool top = y < corner;
                return left == top;
            }
            case Pattern::discs: {
                // Area pi r^2 of a cell of area 1; a full cell at fill = 1.
                const float a = x - 0.5F;
                const float b = y - 0.5F;
                return fused(a, a, b * b) <= p.fill * 0.31830989F || p.fill >= 1.0F;
            }
            case Pattern::noise:
                return hash(column, row) < p.fill;
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

    const SceneView& scene;
    Params p;
    bool everywhere;
};

}  // namespace raynest
