#include "engine/integrators/tonemap.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

namespace raynest {
namespace {

constexpr float middle_grey = 0.18F;

/// A matrix by rows.
Vec3 product(const float (&m)[9], const Vec3& v) {
    return {m[0] * v.x + m[1] * v.y + m[2] * v.z, m[3] * v.x + m[4] * v.y + m[5] * v.z,
            m[6] * v.x + m[7] * v.y + m[8] * v.z};
}

/// Troy Sobotka's AgX, by the polynomial of Benjamin Wrensch ("Minimal AgX Implementation", 2023):
/// its error is below 1 / 255. Linear Rec. 709 on both sides.
Vec3 agx(const Vec3& colour) {
    static constexpr float inset[9] = {
        0.842479062253094F,  0.0784335999999992F, 0.0792237451477643F,
        0.0423282422610123F, 0.878468636469772F,  0.0791661274605434F,
        0.0423756549057051F, 0.0784336F,          0.879142973793104F};
    static constexpr float outset[9] = {
        1.19687900512017F,    -0.0980208811401368F, -0.0990297440797205F,
        -0.0528968517574562F, 1.15190312990417F,    -0.0989611768448433F,
        -0.0529716355144438F, -0.0980434501171241F, 1.15107367264116F};
    constexpr float log_least = -12.47393F;
    constexpr float log_most = 4.026069F;
    Vec3 v = product(inset, colour);
    for (int c = 0; c < 3; ++c) {
        const float log = std::log2(std::max(v[c], 1e-10F));
        const float x = std::clamp((log - log_least) / (log_most - log_least), 0.0F, 1.0F);
        const float x2 = x * x;
        const float x4 = x2 * x2;
        v[c] = 15.5F * x4 * x2 - 40.14F * x4 * x + 31.96F * x4 - 6.868F * x2 * x + 0.4298F * x2 +
               0.1191F * x - 0.00232F;
    }
    v = product(outset, v);
    // The curve ends in display values of gamma 2.2.
    for (int c = 0; c < 3; ++c) v[c] = std::pow(std::clamp(v[c], 0.0F, 1.0F), 2.2F);
    return v;
}

/// The reference and output transforms of ACES, fitted by Stephen Hill (BakingLab, 2017).
Vec3 aces(const Vec3& colour) {
    static constexpr float input[9] = {0.59719F, 0.35458F, 0.04823F, 0.07600F, 0.90834F,
                                       0.01566F, 0.02840F, 0.13383F, 0.83777F};
    static constexpr float output[9] = {1.60475F,  -0.53108F, -0.07367F, -0.10208F, 1.10813F,
                                        -0.00605F, -0.00327F, -0.07276F, 1.07602F};
    Vec3 v = product(input, colour);
    for (int c = 0; c < 3; ++c)
        v[c] = (v[c] * (v[c] + 0.0245786F) - 0.000090537F) /
               (v[c] * (0.983729F * v[c] + 0.4329510F) + 0.238081F);
    return product(output, v);
}

/// Reinhard et al., "Photographic tone reproduction for digital images", 2002, equation 3.
Vec3 reinhard(const Vec3& colour) {
    return colour / (1 + std::max(luminance(colour), 0.0F));
}

Vec3 none(const Vec3& colour) {
    return colour;
}

/// The colour of a premultiplied one; light that is seen where nothing covers a pixel is kept.
Vec3 shown(const Vec4& colour) {
    return Vec3(colour) / (colour.w > 0 ? colour.w : 1);
}

Vec3 mapped(ToneMap tonemap, const Vec3& colour) {
    switch (tonemap) {
#define RAYNEST_TONEMAP(name, text) \
    case ToneMap::name:             \
        return name(colour);
#include "engine/integrators/tonemaps.def"
    }
    return colour;
}

}  // namespace

Result<ToneMap> parse_tonemap(std::string_view name) {
#define RAYNEST_TONEMAP(id, text) \
    if (name == #id) return ToneMap::id;
#include "engine/integrators/tonemaps.def"
    std::string message = "unknown tonemap '" + std::string(name) + "': use one of";
#define RAYNEST_TONEMAP(id, text) message += " " #id;
#include "engine/integrators/tonemaps.def"
    return fail(ErrorCode::param_invalid, std::move(message));
}

Result<std::optional<float>> parse_exposure(std::string_view text) {
    if (text == "auto") return std::optional<float>{};
    float stops = 0;
    const char* const end = text.data() + text.size();
    const auto [last, error] = std::from_chars(text.data(), end, stops);
    if (error != std::errc{} || last != end || !(std::abs(stops) <= exposure_stops_max))
        return fail(ErrorCode::param_invalid, "exposure '" + std::string(text) +
                                                  "' is neither auto nor a number of stops from "
                                                  "-64 to 64");
    return std::optional<float>{stops};
}

float auto_exposure(const Film& film) {
    const std::span<const std::uint32_t> meshes = film.words(FilmLayer::mesh);
    std::vector<float> logs, behind;
    logs.reserve(film.size().pixels());
    for (std::uint64_t i = 0; i < film.size().pixels(); ++i) {
        const float y = luminance(shown(film.colour(i)));
        if (y > 0) (meshes[i] != no_id ? logs : behind).push_back(std::log2(y));
    }
    if (logs.empty()) logs = std::move(behind);
    if (logs.empty()) return 0;
    // Sorted, so that the sum has one order.
    std::ranges::sort(logs);
    const std::size_t cut = logs.size() / 20;
    double sum = 0;
    for (std::size_t i = cut; i < logs.size() - cut; ++i) sum += static_cast<double>(logs[i]);
    const double mean = sum / static_cast<double>(logs.size() - 2 * cut);
    const double stops = std::log2(static_cast<double>(middle_grey)) - mean;
    return static_cast<float>(std::clamp(stops, -static_cast<double>(exposure_stops_max),
                                         static_cast<double>(exposure_stops_max)));
}

Picture show(const Film& film, const Window& window, ToneMap tonemap, float stops) {
    const float gain = std::exp2(stops);
    std::vector<Vec4> pixels;
    pixels.reserve(std::size_t{window.width} * window.height);
    for (std::uint32_t y = 0; y < window.height; ++y) {
        for (std::uint32_t x = 0; x < window.width; ++x) {
            const std::uint64_t pixel =
                std::uint64_t{window.y + y} * film.size().width + window.x + x;
            const Vec4 colour = film.colour(pixel);
            pixels.emplace_back(mapped(tonemap, gain * shown(colour)), colour.w);
        }
    }
    return to_picture(window.width, window.height, pixels);
}

}  // namespace raynest
