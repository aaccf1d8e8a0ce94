// `--integrator primary`: base colour x |n.v|, a picture that shows the surfaces that rays hit, and
// nothing else.
#include "engine/integrators/picture.h"
#include "engine/queries/base_colour.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace raynest {
namespace {

const Vec4 background(0.18F, 0.18F, 0.18F, 0.0F);

float encode_srgb(float linear) {
    return linear <= 0.0031308F ? linear * 12.92F : 1.055F * std::pow(linear, 1 / 2.4F) - 0.055F;
}

/// Returns |n.v| of unit vectors; 1 if the primitive has no normal.
float facing(const Vec3& normal, const Ray& ray) {
    if (normal == Vec3(0)) return 1;
    const glm::dvec3 direction = glm::normalize(glm::dvec3(ray.direction));
    return static_cast<float>(std::abs(glm::dot(glm::dvec3(normal), direction)));
}

}  // namespace

void shade_primary(const ColumnSource& source, std::span<Vec4> out) {
    for (std::size_t i = 0; i < out.size(); ++i) {
        const HitRecord& hit = source.hits[i];
        const Ray& ray = source.rays[i];
        out[i] = hit.hit == 0 ? background
                              : Vec4(base_colour(*source.scene, hit) *
                                         facing(world_normal(source, ray, hit), ray),
                                     1.0F);
    }
}

std::optional<CameraHits> render_primary(const PixelRange& pixels, const ColumnSource& scene,
                                         RayCaster& caster, const PixelArrays& arrays,
                                         std::span<Vec4> out) {
    const std::span<Ray> rays = arrays.rays.first(pixels.rays());
    const std::span<HitRecord> hits = arrays.hits.first(rays.size());
    generate_samples(pixels.camera, pixels.samples, pixels.first, rays, pixels.window);
    const auto* pinhole = std::get_if<Pinhole>(&pixels.camera);
    const bool cast = pinhole != nullptr && pixels.samples == 1 && pixels.window.is_whole()
                          ? caster.closest(PinholeRays{*pinhole, pixels.first, true}, rays, hits)
                          : caster.closest(rays, hits);
    if (!cast) return std::nullopt;

    ColumnSource source = scene;
    source.rays = rays;
    source.hits = hits;
    if (pixels.samples == 1) {
        shade_primary(source, out);
        return count_hits(hits);
    }
    std::vector<Vec4> colours(pixels.samples);
    for (std::size_t i = 0; i < pixels.count; ++i) {
        source.rays = rays.subspan(i * pixels.samples, pixels.samples);
        source.hits = hits.subspan(i * pixels.samples, pixels.samples);
        shade_primary(source, colours);
        Vec4 sum(0);
        for (const Vec4& colour : colours) sum += colour;
        out[i] = sum / static_cast<float>(pixels.samples);
    }
    return count_hits(hits);
}

CameraHits count_hits(std::span<const HitRecord> hits) {
    CameraHits counts;
    counts.rays = hits.size();
    for (const HitRecord& hit : hits) {
        counts.hits += hit.hit;
        counts.backs += hit.hit != 0 && hit.front == 0 ? 1U : 0U;
    }
    return counts;
}

Picture to_picture(std::uint32_t width, std::uint32_t height, std::span<const Vec4> pixels) {
    // NaN and negative numbers become 0.
    const auto to_byte = [](float x) {
        return static_cast<std::uint8_t>(x > 0 ? std::min(x, 1.0F) * 255.0F + 0.5F : 0.0F);
    };
    Picture picture{width, height, {}};
    picture.rgba.reserve(pixels.size() * 4);
    for (const Vec4& p : pixels) {
        for (int channel = 0; channel < 3; ++channel) {
            picture.rgba.push_back(to_byte(encode_srgb(p[channel])));
        }
        picture.rgba.push_back(to_byte(p.w));
    }
    return picture;
}

}  // namespace raynest
