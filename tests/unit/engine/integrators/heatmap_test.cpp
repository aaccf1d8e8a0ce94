#include "engine/integrators/font.h"
#include "engine/integrators/legend.h"
#include "engine/integrators/palette.h"
#include "engine/integrators/picture.h"

#include <doctest/doctest.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <array>
#include <fstream>
#include <numeric>
#include <set>
#include <span>
#include <string>
#include <vector>

using namespace raynest;

namespace {

std::vector<std::uint32_t> one_to(std::uint32_t n) {
    std::vector<std::uint32_t> counts(n);
    std::iota(counts.rbegin(), counts.rend(), 1);
    return counts;
}

HeatStatistics statistics_of(const std::vector<std::uint32_t>& counts,
                             const HeatOptions& options = {}) {
    const auto statistics = heat_statistics(counts, options);
    REQUIRE(statistics.has_value());
    return *statistics;
}

std::array<int, 3> pixel(const Picture& picture, std::uint32_t x, std::uint32_t y) {
    const std::uint8_t* at = &picture.rgba[4 * (std::size_t{y} * picture.width + x)];
    return {at[0], at[1], at[2]};
}

/// True if the text is written somewhere below the map and nothing touches it.
bool shows(const Picture& picture, std::uint32_t map_height, const std::string& text) {
    constexpr Colour ink{255, 255, 255};
    Picture drawn{text_width(text, 1), line_advance - 2, {}};
    drawn.rgba.resize(std::size_t{4} * drawn.width * drawn.height);
    draw_text(drawn, 0, 0, text, 1, ink);
    const std::array<int, 3> paper = pixel(picture, 0, picture.height - 1);
    const auto is_here = [&](std::uint32_t left, std::uint32_t top) {
        for (std::uint32_t y = 0; y < drawn.height; ++y)
            for (std::uint32_t x = 0; x < drawn.width; ++x)
                if ((pixel(picture, left + x, top + y) != paper) !=
                    (pixel(drawn, x, y) == std::array{255, 255, 255}))
                    return false;
        return true;
    };
    for (std::uint32_t top = map_height; top + drawn.height <= picture.height; ++top)
        for (std::uint32_t left = 0; left + drawn.width <= picture.width; ++left)
            if (is_here(left, top)) return true;
    return false;
}

}  // namespace

TEST_CASE("percentiles are exact over all pixels") {
    const HeatStatistics s = statistics_of(one_to(1000));
    CHECK(s.min == 1);
    CHECK(s.p50 == 500);
    CHECK(s.p99 == 990);
    CHECK(s.max == 1000);
    CHECK(s.mean == doctest::Approx(500.5));
    CHECK(s.rays == 1000);
    CHECK(s.range_high == 990);
    CHECK(s.clipped == doctest::Approx(0.01));
    const HeatStatistics one = statistics_of({7});
    CHECK(one.p50 == 7);
    CHECK(one.p99 == 7);
}

TEST_CASE("ranges are p99, auto or two numbers") {
    const auto counts = one_to(100);
    CHECK(statistics_of(counts, {.range = "auto"}).range_high == 100);
    CHECK(statistics_of(counts, {.range = "auto"}).clipped == 0);
    const HeatStatistics fixed = statistics_of(counts, {.range = "20:80.5"});
    CHECK(fixed.range_low == 20);
    CHECK(fixed.range_high == 80.5);
    CHECK(fixed.clipped == doctest::Approx(0.2));
    CHECK(fixed.below == doctest::Approx(0.19));
    CHECK(statistics_of({0, 0, 0}).range_high > 0);  // a map of zeros has a scale too
    // The same everywhere is not the most: it has the middle of the palette.
    for (const char* range : {"p99", "auto"}) {
        CHECK(statistics_of({7, 7, 7}, {.range = range}).range_high == 14);
        CHECK(statistics_of({6, 7, 7}, {.range = range}).range_high == 7);
    }
}

TEST_CASE("ranges end where those of the page and of the Python client do") {
    std::ifstream file(RAYNEST_SOURCE_DIR "/tests/golden/heat_ranges.json");
    const nlohmann::json cases = nlohmann::json::parse(file)["cases"];
    REQUIRE(!cases.empty());
    for (const nlohmann::json& one : cases) {
        std::vector<std::int32_t> values;
        for (const nlohmann::json& run : one["values"])
            values.insert(values.end(), run[1].get<std::size_t>(), run[0].get<std::int32_t>());
        const std::vector<std::uint32_t> counts(values.begin(), values.end());
        for (const char* range : {"auto", "p99"}) {
            INFO(one["what"] << ", " << range);
            const HeatOptions options{.range = range};
            const auto statistics = one.value("difference", false)
                                        ? heat_statistics(values, options)
                                        : heat_statistics(counts, options);
            REQUIRE(statistics);
            CHECK(statistics->range_high == one[range].get<double>());
        }
    }
}

TEST_CASE("unknown options are refused and the choices named") {
    const auto message = [](const HeatOptions& options) {
        const auto statistics = heat_statistics(one_to(4), options);
        REQUIRE_FALSE(statistics.has_value());
        CHECK(statistics.error().code == ErrorCode::param_invalid);
        return statistics.error().message;
    };
    CHECK(message({.metric = "t"}).find("nodes, boxes") != std::string::npos);
    CHECK(message({.palette = "jet"}).find("viridis") != std::string::npos);
    CHECK(message({.scale = "square"}).find("linear, log") != std::string::npos);
    for (const char* range :
         {"", "p98", "3", "5:5", "9:2", "-1:4", "0:inf", "nan:1", "0:1x", "0:1e12"}) {
        CHECK(message({.range = range}).find("low < high <= 4294967295") != std::string::npos);
    }
}

TEST_CASE("palettes run from their first to their last colour without a jump") {
    for (const char* name : {"turbo", "viridis", "inferno", "gray"}) {
        const auto palette = find_palette(name);
        REQUIRE(palette.has_value());
        int largest_step = 0;
        for (std::size_t i = 1; i < palette->size(); ++i) {
            const Colour a = (*palette)[i - 1], b = (*palette)[i];
            largest_step = std::max(
                {largest_step, std::abs(a.r - b.r), std::abs(a.g - b.g), std::abs(a.b - b.b)});
        }
        CHECK(largest_step <= 6);  // the start of turbo: 156 steps of blue over 28 colours
    }
    CHECK((*find_palette("gray"))[0].r == 0);
    CHECK((*find_palette("gray"))[255].r == 255);
    CHECK((*find_palette("gray"))[128].g == 128);
}

TEST_CASE("the scale clamps both ends; a logarithmic one spends its colours on small counts") {
    const HeatScale linear{10, 110, false};
    CHECK(linear.position(60) == doctest::Approx(0.5));
    CHECK(linear.position(0) == 0);
    CHECK(linear.position(1e9) == 1);
    const HeatScale log{0, 999, true};
    CHECK(log.position(0) == 0);
    CHECK(log.position(999) == 1);
    CHECK(log.position(9) == doctest::Approx(1.0 / 3));
    const HeatScale decade{100, 1000, true};
    CHECK(decade.position(std::sqrt(1e5)) == doctest::Approx(0.5));
    CHECK(decade.position(100) == 0);
    CHECK(decade.position(0) == 0);
    CHECK(decade.position(2000) == 1);
}

TEST_CASE("the map keeps every pixel and the legend is below it") {
    const auto counts = one_to(200);
    const HeatOptions options{.palette = "gray", .range = "auto"};
    const auto picture = heat_picture(20, 10, counts, statistics_of(counts, options), options);
    REQUIRE(picture.has_value());
    CHECK(picture->width >= 20);
    CHECK(picture->height > 10);
    CHECK(picture->rgba.size() == std::size_t{4} * picture->width * picture->height);
    CHECK(pixel(*picture, 0, 0) == std::array{255, 255, 255});  // 200 of 200
    CHECK(pixel(*picture, 19, 9) == std::array{1, 1, 1});       // 1 of 200
    for (std::size_t i = 3; i < picture->rgba.size(); i += 4) REQUIRE(picture->rgba[i] == 255);
}

TEST_CASE("the legend shows the palette from end to end") {
    const std::vector<std::uint32_t> counts(900 * 4, 5);
    const HeatOptions options{.palette = "viridis"};
    const auto picture = heat_picture(900, 4, counts, statistics_of(counts, options), options);
    REQUIRE(picture.has_value());
    const Palette palette = *find_palette("viridis");
    std::set<std::array<int, 3>> shown;
    for (std::uint32_t y = 4; y < picture->height; ++y) {
        for (std::uint32_t x = 0; x < 900; ++x) shown.insert(pixel(*picture, x, y));
    }
    for (const Colour& c : palette) CHECK(shown.count({c.r, c.g, c.b}) == 1);
}

TEST_CASE("the legend shows the statistics, each under its own word") {
    const std::vector<std::uint32_t> counts(4, 5);
    HeatStatistics statistics;
    statistics.min = 12;
    statistics.mean = 34.56;
    statistics.p50 = 78;
    statistics.p99 = 901;
    statistics.max = 2345;
    statistics.clipped = 0.067;
    statistics.range_high = 901;
    const auto picture = heat_picture(4, 1, counts, statistics, {.metric = "prims"});
    REQUIRE(picture.has_value());
    for (const char* words : {"min 12", "mean 34.6", "p50 78", "p99 901", "max 2345",
                              "clipped 6.7%", "primitives tested per ray"}) {
        CAPTURE(words);
        CHECK(shows(*picture, 1, words));
    }
    CHECK_FALSE(shows(*picture, 1, "max 901"));
}

TEST_CASE("the legend names what the picture is of, and cuts names that are too long") {
    const std::vector<std::uint32_t> counts(4, 5);
    HeatOptions options;
    options.view = {"woods", "camera " + std::string(300, 'x')};
    const auto picture = heat_picture(4, 1, counts, statistics_of(counts, options), options);
    REQUIRE(picture.has_value());
    CHECK(shows(*picture, 1, "woods"));
    CHECK(shows(*picture, 1, "camera xxx"));
    CHECK(shows(*picture, 1, "xxx..."));
}

TEST_CASE("a picture too narrow for the legend is widened on its right") {
    const auto counts = one_to(5);
    const HeatOptions options{.palette = "gray", .range = "auto"};
    const HeatStatistics statistics = statistics_of(counts, options);
    const auto narrow = heat_picture(1, 5, counts, statistics, options);
    REQUIRE(narrow.has_value());
    REQUIRE(narrow->width == heat_picture_width_min);
    CHECK(pixel(*narrow, 0, 0) == std::array{255, 255, 255});
    CHECK(pixel(*narrow, 0, 4) == std::array{51, 51, 51});  // 1 of 5
    const std::array<int, 3> paper = pixel(*narrow, 0, narrow->height - 1);
    for (std::uint32_t y = 0; y < 5; ++y) CHECK(pixel(*narrow, 1, y) == paper);

    const std::vector<std::uint32_t> row(heat_picture_width_min, 1);
    const auto wide = heat_picture(heat_picture_width_min, 1, row, statistics, options);
    REQUIRE(wide.has_value());
    const auto strip = [](const Picture& picture, std::size_t rows) {
        const auto pixels = std::span(picture.rgba).subspan(4 * picture.width * rows);
        return std::vector(pixels.begin(), pixels.end());
    };
    CHECK(strip(*narrow, 5) == strip(*wide, 1));
}

TEST_CASE("no text of a legend reaches the picture's edge") {
    constexpr std::uint32_t most = 4294967295;
    for (const std::uint32_t width : {1U, 64U, 799U, 800U, 1000U}) {
        for (const char* metric :
             {"nodes", "boxes", "leaves", "prims", "instances", "rejects", "total"}) {
            for (const char* scale : {"linear", "log"}) {
                const std::vector<std::uint32_t> counts(width, most);
                const HeatOptions options{.metric = metric,
                                          .scale = scale,
                                          .range = "0.25:0.75",
                                          .view = {std::string(256, 'w'), std::string(256, 'm')}};
                const auto map =
                    heat_picture(width, 1, counts, statistics_of(counts, options), options);
                REQUIRE(map.has_value());
                CHECK(map->height <= 1 + heat_legend_height_max);
                const std::array<int, 3> paper = pixel(*map, 0, map->height - 1);
                for (std::uint32_t y = 1; y < map->height; ++y) {
                    for (std::uint32_t x = 1; x <= 6; ++x)
                        REQUIRE(pixel(*map, map->width - x, y) == paper);
                }
            }
        }
    }
}

TEST_CASE("counts that do not fill the picture are refused") {
    CHECK_FALSE(heat_picture(2, 2, one_to(3), statistics_of(one_to(3)), {}).has_value());
    CHECK_FALSE(heat_picture(0, 0, std::span<const std::uint32_t>{}, {}, {}).has_value());
}

TEST_CASE("a difference has signed statistics, and a range with zero in its middle") {
    std::vector<std::int32_t> differences(100);
    std::iota(differences.begin(), differences.end(), -80);  // -80 to 19
    const auto measured = [&](const std::string& range) {
        return heat_statistics(differences, {.palette = "diverging", .range = range});
    };
    const auto s = measured("p99");
    REQUIRE(s.has_value());
    CHECK(s->min == -80);
    CHECK(s->p50 == -31);
    CHECK(s->p90 == 9);
    CHECK(s->p99 == 18);
    CHECK(s->max == 19);
    CHECK(s->mean == doctest::Approx(-30.5));
    CHECK(s->range_high == 79);  // by distances from zero
    CHECK(s->range_low == -79);
    CHECK(s->below == doctest::Approx(0.01));
    CHECK(s->clipped == 0);
    CHECK(measured("auto")->range_low == -80);
    CHECK(measured("-10:10")->clipped == doctest::Approx(0.09));
    for (const char* range : {"0:10", "-10:20", "10:-10", "-0:0", "-10", "-nan:nan", "-inf:inf"})
        CHECK_FALSE(measured(range).has_value());
    const std::vector<std::int32_t> equal(4);
    CHECK(heat_statistics(equal, {})->range_high == 1);
}

TEST_CASE("a difference is blue below zero, red above, and its legend has signed ticks") {
    const std::vector<std::int32_t> differences = {-100, -50, 0, 50, 100, 200};
    const HeatOptions options{.palette = "diverging", .range = "-100:100"};
    const auto statistics = heat_statistics(differences, options);
    const auto picture = heat_picture(6, 1, differences, *statistics, options);
    REQUIRE(picture.has_value());
    const auto less = pixel(*picture, 0, 0), more = pixel(*picture, 4, 0);
    CHECK(less[2] > less[0]);
    CHECK(more[0] > more[2]);
    CHECK(pixel(*picture, 1, 0)[2] > pixel(*picture, 1, 0)[0]);
    for (const int channel : pixel(*picture, 2, 0)) CHECK(channel > 230);
    CHECK(pixel(*picture, 5, 0) == more);
    for (const char* text :
         {"-100", ">+100", "0", "+50", "-50", "max +200", "min -100", "difference"})
        CHECK(shows(*picture, 1, text));

    const HeatScale scale{-100, 100, true, true};
    CHECK(scale.position(0) == 0.5);
    CHECK(scale.position(-100) == 0);
    CHECK(scale.position(100) == 1);
    CHECK(scale.position(1000) == 1);
    CHECK(scale.position(10) + scale.position(-10) == doctest::Approx(1));
    CHECK(scale.position(10) > 0.7);
}

TEST_CASE("the bars of a histogram hold every pixel once") {
    const auto bars = [](const auto& values) {
        const std::span whole(values);
        return heat_histogram(whole, *heat_statistics(whole, {}));
    };
    const std::vector<std::uint32_t> counts = one_to(128);
    const auto even = bars(counts);
    REQUIRE(even.size() == heat_bars);
    CHECK(std::ranges::all_of(even, [](std::uint64_t bar) { return bar == 2; }));
    const std::vector<std::int32_t> differences = {-5, -5, 0, 4};
    const auto ends = bars(differences);
    CHECK(ends.front() == 2);
    CHECK(std::accumulate(ends.begin(), ends.end(), std::uint64_t{0}) == 4);
    CHECK(bars(std::vector<std::uint32_t>{7, 7}).front() == 2);
}

TEST_CASE("every letter of the legends has its own glyph") {
    const std::string letters =
        "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz.,:+-=/%()<>_#*";
    const auto drawn = [](char letter) {
        Picture picture{glyph_advance, line_advance, {}};
        picture.rgba.resize(std::size_t{4} * glyph_advance * line_advance);
        draw_text(picture, 0, 0, std::string(1, letter), 1, {255, 255, 255});
        return std::string(picture.rgba.begin(), picture.rgba.end());
    };
    std::set<std::string> shapes{drawn('~')};  // the box of unknown letters
    for (const char letter : letters) CHECK(shapes.insert(drawn(letter)).second);
}

TEST_CASE("text is cut off at the edges of a picture") {
    Picture picture{8, 4, std::vector<std::uint8_t>(8 * 4 * 4)};
    draw_text(picture, -3, -2, "HHHH", 2, {255, 0, 0});
    CHECK(std::count(picture.rgba.begin(), picture.rgba.end(), std::uint8_t{255}) > 0);
    CHECK(text_width("abc", 2) == 34);
    CHECK(text_width("", 2) == 0);
}
