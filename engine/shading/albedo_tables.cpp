#include "engine/shading/albedo_tables.h"

#include "engine/math/sampler.h"
#include "engine/shading/sheen.h"

#include <cmath>
#include <vector>

namespace raynest {
namespace {

constexpr std::uint32_t samples = 1024;

/// The direction whose entry is in column `column`; never quite on the horizon.
Vec3 direction_of(std::size_t column, std::size_t columns) {
    const float root = static_cast<float>(column) / static_cast<float>(columns - 1);
    const float cosine = std::max(root * root, 1e-4F);
    return {std::sqrt(std::max(0.0F, 1.0F - cosine * cosine)), 0, cosine};
}

Vec2 point_of(std::uint32_t i) {
    return Sampler(1, 0, i).pair(0);
}

/// Integrates column by column with visible normals: the weight of a sample is masking over that of
/// one side.
void fill(AlbedoTables& tables) {
    for (std::size_t row = 0; row < AlbedoTable::roughnesses; ++row) {
        const float alpha = ggx_alpha(static_cast<float>(row) / (AlbedoTable::roughnesses - 1));
        for (std::size_t column = 0; column < AlbedoTable::angles; ++column) {
            const Vec3 o = direction_of(column, AlbedoTable::angles);
            double full = 0, edge = 0;
            for (std::uint32_t s = 0; s < samples; ++s) {
                const Vec3 h = sample_ggx(o, alpha, point_of(s));
                const float seen = glm::dot(o, h);
                const Vec3 i = 2.0F * seen * h - o;
                if (i.z <= 0) continue;
                const float weight = (1.0F + ggx_lambda(o, alpha)) * ggx_masking(o, i, alpha);
                full += static_cast<double>(weight);
                edge += static_cast<double>(weight * schlick_weight(seen));
            }
            const std::size_t at = row * AlbedoTable::angles + column;
            tables.full.values[at] = static_cast<float>(full / samples);
            tables.edge.values[at] = static_cast<float>(edge / samples);
        }
    }
    // 2 * integral of albedo(cos) * cos, over the interpolated table itself.
    constexpr int steps = 2048;
    for (std::size_t row = 0; row < AlbedoTable::roughnesses; ++row) {
        const float roughness = static_cast<float>(row) / (AlbedoTable::roughnesses - 1);
        double full = 0, edge = 0;
        for (int s = 0; s < steps; ++s) {
            const float cosine = (static_cast<float>(s) + 0.5F) / steps;
            full += 2.0 * static_cast<double>(cosine * tables.full.at(cosine, roughness));
            edge += 2.0 * static_cast<double>(cosine * tables.edge.at(cosine, roughness));
        }
        tables.full_mean.values[row] = static_cast<float>(full / steps);
        tables.edge_mean.values[row] = static_cast<float>(edge / steps);
    }
}

constexpr std::size_t glass_etas = 24;
constexpr float glass_eta_most = 3.0F;

/// Tables of glass by index ratio, from 1/3 to 3 in equal steps of its logarithm.
struct GlassTables {
    static constexpr std::size_t angles = 24, roughnesses = 16;
    std::vector<float> values = std::vector<float>(glass_etas * roughnesses * angles);
};

float eta_of(std::size_t step) {
    const float place = 2.0F * static_cast<float>(step) / (glass_etas - 1) - 1.0F;
    return std::pow(glass_eta_most, place);
}

/// Single scattering of rough glass: each microfacet either reflects or refracts.
float integrate_glass(const Vec3& o, float alpha, float eta) {
    constexpr std::uint32_t count = 512;
    double sum = 0;
    const float outgoing = 1.0F + ggx_lambda(o, alpha);
    for (std::uint32_t s = 0; s < count; ++s) {
        const Vec3 h = sample_ggx(o, alpha, point_of(s));
        const float seen = glm::dot(o, h);
        const float reflected = fresnel_dielectric(seen, eta);
        const Vec3 mirror = 2.0F * seen * h - o;
        if (mirror.z > 0)
            sum += static_cast<double>(reflected * outgoing * ggx_masking(o, mirror, alpha));
        const float sine2 = (1.0F - seen * seen) / (eta * eta);
        if (sine2 >= 1) continue;
        const float beyond = std::sqrt(1.0F - sine2);
        const Vec3 through = (seen / eta - beyond) * h - o / eta;
        if (through.z < 0)
            sum +=
                static_cast<double>((1.0F - reflected) * outgoing * ggx_masking(o, through, alpha));
    }
    return static_cast<float>(sum / count);
}

const GlassTables& glass_tables() {
    static const GlassTables tables = [] {
        GlassTables t;
        std::size_t at = 0;
        for (std::size_t e = 0; e < glass_etas; ++e) {
            for (std::size_t r = 0; r < GlassTables::roughnesses; ++r) {
                const float roughness = static_cast<float>(r) / (GlassTables::roughnesses - 1);
                for (std::size_t a = 0; a < GlassTables::angles; ++a) {
                    t.values[at++] = integrate_glass(direction_of(a, GlassTables::angles),
                                                     ggx_alpha(roughness), eta_of(e));
                }
            }
        }
        return t;
    }();
    return tables;
}

struct SheenTables {
    static constexpr std::size_t angles = 32, roughnesses = 16;
    static constexpr std::uint32_t samples = 4096;
    std::array<float, angles * roughnesses> values{};
};

const SheenTables& sheen_tables() {
    static const SheenTables tables = [] {
        SheenTables t;
        for (std::size_t r = 0; r < SheenTables::roughnesses; ++r) {
            const float roughness = static_cast<float>(r) / (SheenTables::roughnesses - 1);
            for (std::size_t a = 0; a < SheenTables::angles; ++a) {
                const Vec3 o = direction_of(a, SheenTables::angles);
                const SheenLobe lobe(o.z, roughness);
                double sum = 0;
                for (std::uint32_t s = 0; s < SheenTables::samples; ++s) {
                    const Vec3 i = sample_cosine(point_of(s));
                    if (i.z > 0) sum += static_cast<double>(pi * lobe.evaluate(o, i) / i.z);
                }
                t.values[r * SheenTables::angles + a] =
                    std::min(static_cast<float>(sum / SheenTables::samples), 1.0F);
            }
        }
        return t;
    }();
    return tables;
}

/// Splits a place in [0, 1] into the index of one of `steps` entries and the part beyond it.
float split(float place, std::size_t steps, std::size_t& index) {
    const float p = std::clamp(place, 0.0F, 1.0F) * static_cast<float>(steps - 1);
    index = std::min(static_cast<std::size_t>(p), steps - 2);
    return p - static_cast<float>(index);
}

}  // namespace

const AlbedoTables& albedo_tables() {
    static const AlbedoTables tables = [] {
        AlbedoTables t;
        fill(t);
        return t;
    }();
    return tables;
}

float glass_albedo(float cosine, float roughness, float eta) {
    const std::vector<float>& values = glass_tables().values;
    constexpr std::size_t angles = GlassTables::angles;
    constexpr std::size_t roughnesses = GlassTables::roughnesses;
    std::size_t e = 0, r = 0, a = 0;
    const float fe = split(0.5F + 0.5F * std::log(eta) / std::log(glass_eta_most), glass_etas, e);
    const float fr = split(roughness, roughnesses, r);
    const float fa = split(std::sqrt(std::clamp(std::abs(cosine), 0.0F, 1.0F)), angles, a);
    float sum = 0;
    for (std::size_t corner = 0; corner < 8; ++corner) {
        const std::size_t de = corner & 1, dr = corner >> 1 & 1, da = corner >> 2 & 1;
        const float weight =
            (de != 0 ? fe : 1 - fe) * (dr != 0 ? fr : 1 - fr) * (da != 0 ? fa : 1 - fa);
        sum += weight * values[((e + de) * roughnesses + r + dr) * angles + a + da];
    }
    return std::max(sum, 0.05F);
}

float sheen_albedo(float cosine, float roughness) {
    constexpr std::size_t angles = SheenTables::angles;
    std::size_t a = 0, r = 0;
    const float fa = split(std::sqrt(std::clamp(cosine, 0.0F, 1.0F)), angles, a);
    const float fr = split(roughness, SheenTables::roughnesses, r);
    const float* v = &sheen_tables().values[r * angles + a];
    const float low = v[0] + fa * (v[1] - v[0]);
    const float high = v[angles] + fa * (v[angles + 1] - v[angles]);
    return low + fr * (high - low);
}

}  // namespace raynest
