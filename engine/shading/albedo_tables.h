// How much light the microfacets of a rough surface send on after one bounce, by angle and
// roughness: the tables that make lobes conserve energy. They are computed once per process, always
// the same.
#pragma once

#include "engine/shading/ggx.h"

#include <array>
#include <cstddef>

namespace raynest {

/// A table over the cosine with the normal and the roughness, bilinear.
struct AlbedoTable {
    static constexpr std::size_t angles = 64;
    static constexpr std::size_t roughnesses = 32;
    std::array<float, angles * roughnesses> values{};

    [[nodiscard]] float at(float cosine, float roughness) const {
        // Rows crowd near the horizon, where albedo changes fast.
        const float x = std::sqrt(std::clamp(cosine, 0.0F, 1.0F)) * (angles - 1);
        const float y = std::clamp(roughness, 0.0F, 1.0F) * (roughnesses - 1);
        const auto column = std::min(static_cast<std::size_t>(x), angles - 2);
        const auto row = std::min(static_cast<std::size_t>(y), roughnesses - 2);
        const float fx = x - static_cast<float>(column);
        const float fy = y - static_cast<float>(row);
        const float* v = &values[row * angles + column];
        const float low = v[0] + fx * (v[1] - v[0]);
        const float high = v[angles] + fx * (v[angles + 1] - v[angles]);
        return low + fy * (high - low);
    }
};

/// A mean over the hemisphere with the cosine as weight, by roughness.
struct MeanAlbedoTable {
    std::array<float, AlbedoTable::roughnesses> values{};

    [[nodiscard]] float at(float roughness) const {
        const float y = std::clamp(roughness, 0.0F, 1.0F) * (AlbedoTable::roughnesses - 1);
        const auto row = std::min(static_cast<std::size_t>(y), AlbedoTable::roughnesses - 2);
        const float fy = y - static_cast<float>(row);
        return values[row] + fy * (values[row + 1] - values[row]);
    }
};

/// One bounce of a GGX lobe with Schlick's Fresnel term reflects f0 * (full - edge) + edge.
struct AlbedoTables {
    AlbedoTable full;  ///< f0 = 1: what one bounce reflects of all light
    AlbedoTable edge;  ///< f0 = 0: by grazing angles alone
    MeanAlbedoTable full_mean, edge_mean;
};

[[nodiscard]] const AlbedoTables& albedo_tables();

/// AlbedoTables::full and ::edge at one angle.
struct OneBounce {
    float full = 1, edge = 0;
};

/// The two rows of both tables between which a roughness falls: a surface needs them for two
/// angles.
class AlbedoRows {
public:
    AlbedoRows() = default;
    AlbedoRows(const AlbedoTables& tables, float roughness) {
        const float y = std::clamp(roughness, 0.0F, 1.0F) * (AlbedoTable::roughnesses - 1);
        const auto row = std::min(static_cast<std::size_t>(y), AlbedoTable::roughnesses - 2);
        full_ = &tables.full.values[row * AlbedoTable::angles];
        edge_ = &tables.edge.values[row * AlbedoTable::angles];
        part_ = y - static_cast<float>(row);
    }
    [[nodiscard]] OneBounce at(float cosine) const {
        const float x = std::sqrt(std::clamp(cosine, 0.0F, 1.0F)) * (AlbedoTable::angles - 1);
        const auto column = std::min(static_cast<std::size_t>(x), AlbedoTable::angles - 2);
        const float part = x - static_cast<float>(column);
        const auto value = [&](const float* v) {
            v += column;
            const float low = v[0] + part * (v[1] - v[0]);
            const float high = v[AlbedoTable::angles] +
                               part * (v[AlbedoTable::angles + 1] - v[AlbedoTable::angles]);
            return low + part_ * (high - low);
        };
        return {value(full_), value(edge_)};
    }

private:
    const float* full_ = nullptr;
    const float* edge_ = nullptr;
    float part_ = 0;
};

/// The same for a rough border between two transparent media, reflected and transmitted light
/// together, exact Fresnel: by index beyond over index on this side.
[[nodiscard]] float glass_albedo(float cosine, float roughness, float eta);

/// Share of all light that the white lobe of sheen reflects; at most 1.
[[nodiscard]] float sheen_albedo(float cosine, float roughness);

}  // namespace raynest
