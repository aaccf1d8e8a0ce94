#include "engine/integrators/tonemap.h"

#include <doctest/doctest.h>

#include <cmath>
#include <vector>

using namespace raynest;

namespace {

Film plain(const Vec3& colour, float alpha = 1) {
    Film film({2, 1});
    for (const std::uint64_t pixel : {0U, 1U}) {
        std::vector<FilmSample> sample(1);
        sample[0].radiance = colour;
        sample[0].alpha = alpha;
        film.add(pixel, 0, sample);
    }
    return film;
}

int red(ToneMap tonemap, float value, float stops = 0) {
    return show(plain(Vec3(value)), {0, 0, 2, 1}, tonemap, stops).rgba[0];
}

}  // namespace

TEST_CASE("every tone map rises from black to white, and stays there") {
    for (const ToneMap tonemap : {ToneMap::agx, ToneMap::aces, ToneMap::reinhard, ToneMap::none}) {
        CAPTURE(static_cast<int>(tonemap));
        CHECK(red(tonemap, 0) <= 1);
        int last = 0;
        for (float value = 0.001F; value < 2e4F; value *= 1.3F) {
            const int next = red(tonemap, value);
            CHECK(next >= last);
            last = next;
        }
        CHECK(last >= 254);
    }
    // Middle grey, 118 in sRGB, stays near itself.
    CHECK(std::abs(red(ToneMap::none, 0.18F) - 118) <= 1);
    CHECK(std::abs(red(ToneMap::agx, 0.18F) - 118) <= 14);
    CHECK(red(ToneMap::none, 0.18F, 1) == red(ToneMap::none, 0.36F));
}

TEST_CASE("a bright red keeps its hue in reinhard, and goes to white in agx") {
    const Film film = plain({50, 0.5F, 0.5F});
    const auto agx = show(film, {0, 0, 1, 1}, ToneMap::agx, 0).rgba;
    CHECK(agx[1] > 60);
    const auto reinhard = show(film, {0, 0, 1, 1}, ToneMap::reinhard, 0).rgba;
    CHECK(reinhard[1] < 60);
}

TEST_CASE("the automatic exposure puts the mean at middle grey, and black stays black") {
    const float stops = auto_exposure(plain(Vec3(100)));
    CHECK(100 * std::exp2(stops) == doctest::Approx(0.18F));
    CHECK(auto_exposure(plain(Vec3(0))) == 0);
}

TEST_CASE("the automatic exposure meters surfaces, not what lies behind them") {
    // One pixel in fifty shows a surface.
    Film film({50, 1});
    for (std::uint64_t pixel = 0; pixel < 50; ++pixel) {
        std::vector<FilmSample> sample(1);
        sample[0].radiance = Vec3(pixel == 7 ? 2.0F : 1000.0F);
        sample[0].alpha = 1;
        if (pixel == 7) sample[0].mesh = 0;
        film.add(pixel, 0, sample);
    }
    CHECK(2 * std::exp2(auto_exposure(film)) == doctest::Approx(0.18F));
    // At an edge a surface covers half of a pixel, before nothing.
    Film edge({2, 1});
    std::vector<FilmSample> sample(2);
    sample[0].radiance = Vec3(3);
    sample[0].alpha = 1;
    sample[0].mesh = 0;
    edge.add(1, 0, sample);
    CHECK(3 * std::exp2(auto_exposure(edge)) == doctest::Approx(0.18F));
}

TEST_CASE("the automatic exposure leaves out the brightest and the darkest twentieth") {
    Film film({100, 1});
    for (std::uint64_t pixel = 0; pixel < 100; ++pixel) {
        std::vector<FilmSample> sample(1);
        sample[0].radiance = Vec3(pixel < 4    ? 1e6F
                                  : pixel < 8  ? 1e-6F
                                  : pixel == 8 ? 100.0F
                                               : 2.0F);
        sample[0].alpha = 1;
        sample[0].mesh = 0;
        film.add(pixel, 0, sample);
    }
    CHECK(2 * std::exp2(auto_exposure(film)) == doctest::Approx(0.18F));
}

TEST_CASE("colours are divided by alpha, and light without coverage is seen") {
    const auto half = show(plain(Vec3(0.25F), 0.5F), {0, 0, 1, 1}, ToneMap::none, 0).rgba;
    CHECK(half[0] == red(ToneMap::none, 0.5F));
    CHECK(half[3] == 128);
    const auto sky = show(plain(Vec3(0.5F), 0), {1, 0, 1, 1}, ToneMap::none, 0).rgba;
    CHECK(sky[0] == red(ToneMap::none, 0.5F));
    CHECK(sky[3] == 0);
}

TEST_CASE("words of tone maps and exposures are checked") {
    CHECK(parse_tonemap("aces").value() == ToneMap::aces);
    CHECK_FALSE(parse_tonemap("filmic").has_value());
    CHECK(parse_exposure("auto").value() == std::nullopt);
    CHECK(parse_exposure("-1.5").value() == -1.5F);
    for (const char* bad : {"", "nan", "inf", "65", "1x", "bright"})
        CHECK_FALSE(parse_exposure(bad).has_value());
}
