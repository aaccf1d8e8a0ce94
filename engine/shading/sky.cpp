#include "engine/shading/sky.h"

#include <array>
#include <cmath>

namespace raynest {
namespace {

constexpr double turbidity = 3;  ///< a clear day
/// Units of a picture per kilocandela and square metre.
constexpr double scale = 1.0 / 36;
constexpr double sun_kilolux = 128;  ///< outside the atmosphere
constexpr double sun_radius = 0.2666 * std::numbers::pi / 180;
constexpr double ground_albedo = 0.2;
/// Smooth enough, and small enough to stay in a core's cache: half the size of 512 x 256 a side.
constexpr std::uint32_t width = 256, height = 128;

/// Perez' function with the coefficients of one of Y, x and y.
struct Perez {
    double a, b, c, d, e;
    [[nodiscard]] double at(double cosine, double gamma) const {
        const double g = std::cos(gamma);
        return (1 + a * std::exp(b / cosine)) * (1 + c * std::exp(d * gamma) + e * g * g);
    }
};

constexpr double t = turbidity;
constexpr std::array<Perez, 3> perez = {{
    {0.1787 * t - 1.4630, -0.3554 * t + 0.4275, -0.0227 * t + 5.3251, 0.1206 * t - 2.5771,
     -0.0670 * t + 0.3703},
    {-0.0193 * t - 0.2592, -0.0665 * t + 0.0008, -0.0004 * t + 0.2125, -0.0641 * t - 0.8989,
     -0.0033 * t + 0.0452},
    {-0.0167 * t - 0.2608, -0.0950 * t + 0.0092, -0.0079 * t + 0.2102, -0.0441 * t - 1.6537,
     -0.0109 * t + 0.0529},
}};

/// Luminance and chromaticities at the zenith, for the sun's angle from it.
std::array<double, 3> zenith(double s) {
    const double chi = (4.0 / 9 - t / 120) * (std::numbers::pi - 2 * s);
    const double s2 = s * s;
    const double s3 = s2 * s;
    const double x = t * t * (0.00166 * s3 - 0.00375 * s2 + 0.00209 * s) +
                     t * (-0.02903 * s3 + 0.06377 * s2 - 0.03202 * s + 0.00394) +
                     (0.11693 * s3 - 0.21196 * s2 + 0.06052 * s + 0.25886);
    const double y = t * t * (0.00275 * s3 - 0.00610 * s2 + 0.00317 * s) +
                     t * (-0.04214 * s3 + 0.08970 * s2 - 0.04153 * s + 0.00516) +
                     (0.15346 * s3 - 0.26756 * s2 + 0.06670 * s + 0.26688);
    return {(4.0453 * t - 4.9710) * std::tan(chi) - 0.2155 * t + 2.4192, x, y};
}

/// CIE xyY -> linear Rec. 709, without colours outside of it.
Vec3 to_rgb(double luminance, double x, double y) {
    const double xx = luminance * x / y;
    const double zz = luminance * (1 - x - y) / y;
    const glm::dvec3 rgb(3.2406 * xx - 1.5372 * luminance - 0.4986 * zz,
                         -0.9689 * xx + 1.8758 * luminance + 0.0415 * zz,
                         0.0557 * xx - 0.2040 * luminance + 1.0570 * zz);
    return Vec3(glm::max(rgb, glm::dvec3(0)));
}

/// The share of sunlight that air, dust and ozone let through, at the wavelengths of R, G and B.
glm::dvec3 transmittance(double from_zenith) {
    const double degrees = from_zenith * 180 / std::numbers::pi;
    const double mass =
        1 / (std::cos(from_zenith) + 0.15 * std::pow(std::max(93.885 - degrees, 0.1), -1.253));
    const double dust = 0.04608 * t - 0.04586;
    constexpr std::array<double, 3> wavelength = {0.61, 0.55, 0.465};  // micrometres
    constexpr std::array<double, 3> ozone = {0.12, 0.09, 0.015};
    glm::dvec3 through;
    for (int c = 0; c < 3; ++c) {
        const auto i = static_cast<std::size_t>(c);
        through[c] = std::exp(-mass * (0.008735 * std::pow(wavelength[i], -4.08) +
                                       dust * std::pow(wavelength[i], -1.3) + 0.35 * ozone[i]));
    }
    return through;
}

}  // namespace

Sky make_sky(float azimuth_degrees, float elevation_degrees) {
    const double elevation =
        std::clamp(static_cast<double>(elevation_degrees), -90.0, 90.0) * std::numbers::pi / 180;
    const auto azimuth =
        static_cast<float>(static_cast<double>(azimuth_degrees) * std::numbers::pi / 180);
    // The model ends at the horizon: below it the sky keeps its colours and darkens to the end of
    // twilight, 18 degrees below.
    const double low = std::max(elevation, 1.0 * std::numbers::pi / 180);
    const double dusk = std::clamp(1 + elevation * 10 / std::numbers::pi, 0.0, 1.0);
    const double brightness = scale * dusk * dusk * dusk;
    const double from_zenith = std::numbers::pi / 2 - low;

    Sky sky;
    sky.sun.direction = from_azimuth(azimuth, static_cast<float>(elevation));
    const glm::dvec3 seen(from_azimuth(azimuth, static_cast<float>(low)));
    const std::array<double, 3> top = zenith(from_zenith);
    std::vector<Vec3> pixels(std::size_t{width} * height);
    for (std::uint32_t row = 0; row < height / 2; ++row) {
        const double polar = std::numbers::pi * (row + 0.5) / height;
        for (std::uint32_t column = 0; column < width; ++column) {
            const double around = 2 * std::numbers::pi * ((column + 0.5) / width - 0.5);
            const glm::dvec3 direction(std::sin(polar) * std::sin(around), std::cos(polar),
                                       -std::sin(polar) * std::cos(around));
            const double gamma = std::acos(std::clamp(glm::dot(direction, seen), -1.0, 1.0));
            std::array<double, 3> value{};
            for (std::size_t i = 0; i < 3; ++i)
                value[i] = top[i] * perez[i].at(std::max(std::cos(polar), 0.01), gamma) /
                           perez[i].at(1, from_zenith);
            pixels[std::size_t{row} * width + column] =
                static_cast<float>(brightness) * to_rgb(value[0], value[1], value[2]);
        }
    }
    Vec3 ground = Environment(width, height, pixels).irradiance_up();

    const double cosine = std::cos(sun_radius);
    sky.sun.cosine = static_cast<float>(cosine);
    if (elevation > -sun_radius) {
        const glm::dvec3 irradiance = scale * sun_kilolux * transmittance(from_zenith);
        const double solid_angle = 2 * std::numbers::pi * (1 - static_cast<double>(sky.sun.cosine));
        sky.sun.radiance = Vec3(irradiance / solid_angle);
        ground += Vec3(irradiance * std::max(std::sin(elevation), 0.0));
    }
    ground *= static_cast<float>(ground_albedo / std::numbers::pi);
    for (std::size_t i = std::size_t{width} * height / 2; i < pixels.size(); ++i)
        pixels[i] = ground;
    sky.environment = Environment(width, height, pixels);
    return sky;
}

}  // namespace raynest
