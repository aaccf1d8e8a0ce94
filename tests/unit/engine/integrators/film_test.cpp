#include "engine/integrators/film.h"

#include "engine/math/sampler.h"
#include "tests/unit/engine/integrators/same_bytes.h"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

using namespace raynest;
using test::same_bytes;

namespace {

std::vector<FilmSample> some_samples(std::uint32_t count) {
    std::vector<FilmSample> samples(count);
    for (std::uint32_t i = 0; i < count; ++i) {
        const Vec2 random = Sampler(7, 3, i).pair(1);
        samples[i].radiance = {random.x, 10 * random.y, random.x * random.y};
        samples[i].alpha = random.x > 0.5F ? 1.0F : 0.0F;
        samples[i].normal = {0, 0, 1};
        samples[i].depth = 5 + random.x;
        samples[i].mesh = i;
    }
    return samples;
}

}  // namespace

TEST_CASE("a film has the same bytes however its samples were dealt") {
    const auto samples = some_samples(1000);
    Film at_once({2, 1});
    at_once.add(1, 0, samples);
    for (const std::size_t step : {1U, 7U, 512U}) {
        Film in_steps({2, 1});
        for (std::size_t i = 0; i < samples.size(); i += step) {
            in_steps.add(1, static_cast<std::uint32_t>(i),
                         std::span(samples).subspan(i, std::min(step, samples.size() - i)));
        }
        CHECK(same_bytes(at_once, in_steps));
    }
    // Copied through the planes alone, as a file holds them.
    Film first({2, 1});
    first.add(1, 0, std::span(samples).first(300));
    Film read({2, 1});
    for (std::size_t i = 0; i < film_layers; ++i) {
        const auto layer = static_cast<FilmLayer>(i);
        std::ranges::copy(first.words(layer), read.words(layer).begin());
    }
    CHECK(read.taken(1) == 300);
    read.add(1, 300, std::span(samples).subspan(300));
    CHECK(same_bytes(at_once, read));
}

TEST_CASE("a film holds mean, variance and the first surface") {
    const auto samples = some_samples(4096);
    Film film({1, 1});
    film.add(0, 0, samples);
    std::array<double, 3> sum{};
    double lum = 0;
    double squares = 0;
    for (const FilmSample& sample : samples) {
        for (int c = 0; c < 3; ++c)
            sum[static_cast<std::size_t>(c)] += static_cast<double>(sample.radiance[c]);
        const auto y = static_cast<double>(luminance(sample.radiance));
        lum += y;
        squares += y * y;
    }
    const double n = 4096;
    for (int c = 0; c < 3; ++c)
        CHECK(static_cast<double>(film.colour(0)[c]) ==
              doctest::Approx(sum[static_cast<std::size_t>(c)] / n).epsilon(1e-5).scale(0));
    const double variance = squares / n - lum / n * lum / n;
    CHECK(static_cast<double>(film.floats(FilmLayer::variance)[0]) ==
          doctest::Approx(variance).epsilon(1e-4).scale(0));
    CHECK(static_cast<double>(film.error(0)) ==
          doctest::Approx(std::sqrt(variance / (n - 1))).epsilon(1e-4).scale(0));
    CHECK(film.floats(FilmLayer::z)[0] == samples[0].depth);
    CHECK(film.words(FilmLayer::mesh)[0] == 0);
}

TEST_CASE("the error of two samples is that of a mean of two") {
    std::vector<FilmSample> samples(2);
    samples[0].radiance = Vec3(1);
    samples[1].radiance = Vec3(3);
    Film film({1, 1});
    film.add(0, 0, samples);
    CHECK(film.floats(FilmLayer::variance)[0] == doctest::Approx(1));
    CHECK(film.error(0) == doctest::Approx(1));
}

TEST_CASE("samples that are not finite are counted and dropped") {
    auto samples = some_samples(8);
    samples[2].radiance.y = std::numeric_limits<float>::quiet_NaN();
    samples[5].radiance.x = std::numeric_limits<float>::infinity();
    Film film({1, 1});
    film.add(0, 0, samples);
    CHECK(film.words(FilmLayer::samples)[0] == 6);
    CHECK(film.dropped() == 2);
    CHECK(film.taken(0) == 8);
    CHECK(std::isfinite(film.colour(0).x));
}

TEST_CASE("a film of the brightest samples stays finite, so that it can be continued") {
    constexpr float most = std::numeric_limits<float>::max();
    auto samples = some_samples(8);
    samples[0].depth = std::numeric_limits<float>::infinity();
    samples[1].radiance = Vec3(1e30F);
    samples[4].radiance = {most, 0, 0};
    samples[6].radiance = Vec3(most);
    Film film({1, 1});
    film.add(0, 0, samples);
    for (std::size_t i = 0; i < film_layers; ++i)
        if (film_layer_table()[i].is_float)
            CHECK(std::isfinite(film.floats(static_cast<FilmLayer>(i))[0]));
    CHECK(film.taken(0) == 8);
    CHECK(std::isfinite(film.error(0)));
}

TEST_CASE("a sampler's points are spread evenly, and differ by seed, pixel and dimension") {
    // Each cell of 16 x 16 holds one of the 256 points of a pair.
    for (const std::uint32_t dimension : {0U, 1U, 9U}) {
        std::array<int, 256> cells{};
        for (std::uint32_t i = 0; i < 256; ++i) {
            const Vec2 point = Sampler(1, 2, i).pair(dimension);
            REQUIRE(point.x >= 0);
            REQUIRE(point.x < 1);
            REQUIRE(point.y >= 0);
            REQUIRE(point.y < 1);
            ++cells[static_cast<std::size_t>(point.x * 16) * 16 +
                    static_cast<std::size_t>(point.y * 16)];
        }
        CHECK(std::ranges::count(cells, 1) == 256);
    }
    CHECK(Sampler(1, 2, 3).pair(4) == Sampler(1, 2, 3).pair(4));
    CHECK(Sampler(2, 2, 3).pair(4) != Sampler(1, 2, 3).pair(4));
    CHECK(Sampler(1, 3, 3).pair(4) != Sampler(1, 2, 3).pair(4));
    CHECK(Sampler(1, 2, 3).pair(5) != Sampler(1, 2, 3).pair(4));
    // Dimensions of a sample do not correlate.
    double product = 0;
    for (std::uint32_t i = 0; i < 4096; ++i) {
        const Sampler sampler(1, 2, i);
        product += static_cast<double>((sampler.one(1) - 0.5F) * (sampler.one(2) - 0.5F));
    }
    CHECK(std::abs(product / 4096) < 0.005);
}
