// Pictures from outside, decoded in the import child: as in this process, and never trusted.
#include "engine/assets/sandbox/picture_child.h"

#include "engine/assets/images/exr_header.h"
#include "tests/sanitized.h"
#include "tests/unit/engine/assets/describe.h"
#include "tests/unit/engine/assets/samples.h"
#include "tests/unit/engine/assets/test_child.h"

#include <doctest/doctest.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <chrono>
#include <limits>
#include <string>
#include <vector>

using namespace raynest;
using test::child;

namespace {

std::vector<std::byte> bytes_of(const std::string& text) {
    const auto bytes = std::as_bytes(std::span(text));
    return {bytes.begin(), bytes.end()};
}

/// A Radiance picture of one colour, without compression.
std::string radiance(int width, int height, const std::string& pixels) {
    return fmt::format("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {} +X {}\n", height, width) +
           pixels;
}

std::string plain_pixels(std::size_t count) {
    std::string pixels;
    for (std::size_t i = 0; i < count; ++i) pixels += "\x80\x40\x20\x81";
    return pixels;
}

Result<LightPicture> surroundings(const std::string& file, const ImportLimits& limits = {},
                                  const char* mode = "--import-child") {
    return decode_environment_in_child(bytes_of(file), limits, child(mode));
}

std::string why_not(const std::string& file, const ImportLimits& limits = {},
                    const char* mode = "--import-child") {
    const auto picture = surroundings(file, limits, mode);
    REQUIRE_FALSE(picture.has_value());
    return picture.error().message;
}

}  // namespace

TEST_CASE("a picture of the surroundings comes through the child as from this process" *
          doctest::test_suite("images")) {
    if (!test::have_images()) return;
    const std::string file = radiance(4, 2, plain_pixels(8));
    const auto here = decode_environment(bytes_of(file), 16384, 1 << 20);
    const auto there = surroundings(file);
    REQUIRE(here.has_value());
    REQUIRE_MESSAGE(there.has_value(), (there ? "" : there.error().message));
    CHECK(there->width == 4);
    CHECK(there->height == 2);
    CHECK(there->rgb == here->rgb);
    CHECK(there->rgb[3].x == 2 * there->rgb[3].y);
}

TEST_CASE("pixels of the surroundings that are not finite are left out and counted, in any format" *
          doctest::test_suite("images")) {
    if (!test::have_images()) return;
    constexpr float infinite = std::numeric_limits<float>::infinity();
    std::vector<float> red(8, 2.0F), green(8, -1.0F), blue(8, light_radiance_max);
    red[1] = infinite;
    green[3] = std::numeric_limits<float>::quiet_NaN();
    blue[4] = 2 * light_radiance_max;
    green[6] = -infinite;
    const std::array channels{Channel{"R", red, {}}, Channel{"G", green, {}},
                              Channel{"B", blue, {}}};
    const auto exr = encode_exr(4, 2, channels);
    REQUIRE(exr.has_value());
    // A Radiance picture ends at 1.7e38, which stands for what is infinite.
    const std::string brightest = "\xff\xff\xff\xff";
    const std::string hdr = radiance(4, 2,
                                     plain_pixels(1) + brightest + plain_pixels(1) + brightest +
                                         brightest + plain_pixels(1) + brightest + plain_pixels(1));
    for (const std::string& file :
         {std::string(reinterpret_cast<const char*>(exr->data()), exr->size()), hdr}) {
        const auto picture = surroundings(file);
        REQUIRE_MESSAGE(picture.has_value(), (picture ? "" : picture.error().message));
        CHECK(picture->left_out == 4);
        for (std::size_t i = 0; i < 8; ++i) {
            const bool left_out = i == 1 || i == 3 || i == 4 || i == 6;
            CHECK((picture->rgb[i] == Vec3(0)) == left_out);
        }
    }
    const auto picture =
        surroundings(std::string(reinterpret_cast<const char*>(exr->data()), exr->size()));
    CHECK(picture->rgb[0] == Vec3(2, 0, light_radiance_max));
}

TEST_CASE("hostile pictures of the surroundings end in an error of the child" *
          doctest::test_suite("images")) {
    if (!test::have_images()) return;
    CHECK(test::contains(why_not("not a picture"), "neither an EXR nor an HDR"));
    CHECK(test::contains(why_not(""), "neither an EXR nor an HDR"));
    // Bombs: a short file that claims many pixels.
    CHECK(test::contains(why_not(radiance(60000, 60000, "")), "60000 x 60000 pixels"));
    CHECK(test::contains(why_not(radiance(16384, 16384, plain_pixels(8))),
                         "MiB decoded are allowed"));
    ImportLimits limits;
    limits.image_bytes_max = 4ULL << 30;
    limits.bytes_max = 1536ULL << 20;
    if (!test::sanitized) {  // sanitizers need more address space than any limit
        const auto bomb = surroundings(radiance(16384, 16384, plain_pixels(8)), limits);
        REQUIRE_FALSE(bomb.has_value());
        CHECK(bomb.error().code == ErrorCode::out_of_memory);
    }
    CHECK(test::contains(why_not(radiance(64, 64, plain_pixels(100))), "damaged or cut short"));
    const std::vector<float> plane(64 * 32, 1.0F);
    const std::array channels{Channel{"R", plane, {}}, Channel{"G", plane, {}},
                              Channel{"B", plane, {}}};
    const auto encoded = encode_exr(64, 32, channels);
    REQUIRE(encoded.has_value());
    const std::string exr(reinterpret_cast<const char*>(encoded->data()), encoded->size());
    REQUIRE(surroundings(exr).has_value());
    CHECK_FALSE(surroundings(exr.substr(0, exr.size() / 2)).has_value());
    // Any byte may be wrong: an error or a picture, but nothing else.
    for (std::size_t i = 0; i < exr.size(); i += std::max<std::size_t>(exr.size() / 40, 1)) {
        std::string wrong = exr;
        wrong[i] = static_cast<char>(wrong[i] ^ 0x5A);
        const auto picture = surroundings(wrong);
        if (!picture) CHECK(picture.error().code != ErrorCode::internal);
    }
}

TEST_CASE("a child that does not decode a picture, but misbehaves, is an error") {
    CHECK(test::contains(why_not("x", {}, "--crash"), "ended the import process"));
    CHECK(test::contains(why_not("x", {}, "--crash"), "the environment"));
    CHECK(test::contains(why_not("x", {}, "--junk"), "incomplete result"));
    ImportLimits limits;
    limits.time_max = std::chrono::seconds(1);
    CHECK(test::contains(why_not("x", limits, "--hang"), "longer than 1 s"));
}

namespace {

constexpr std::uint32_t exr_width = 6;
constexpr std::uint32_t exr_height = 4;

/// An EXR of three channels, two of them floats.
struct Exr {
    Exr() {
        for (std::uint32_t i = 0; i < exr_width * exr_height; ++i) {
            depth.push_back(0.5F + static_cast<float>(i));
            ids.push_back(i * i);
        }
        const std::array channels{Channel{"Z", depth, {}}, Channel{"R", depth, {}},
                                  Channel{"mesh", {}, ids}};
        auto encoded = encode_exr(exr_width, exr_height, channels);
        REQUIRE(encoded.has_value());
        bytes = std::move(*encoded);
    }
    [[nodiscard]] auto decode(const char* mode = "--import-child",
                              const ImportLimits& limits = {}) const {
        return decode_exr_in_child(bytes, exr_width, exr_height, types, limits, child(mode));
    }
    [[nodiscard]] std::string why_not(const char* mode, const ImportLimits& limits = {}) const {
        const auto planes = decode(mode, limits);
        REQUIRE_FALSE(planes.has_value());
        return planes.error().message;
    }

    std::vector<float> depth;
    std::vector<std::uint32_t> ids;
    std::vector<std::byte> bytes;
    std::vector<ChannelType> types = {{"mesh", false}, {"R", true}, {"Z", true}};
};

}  // namespace

TEST_CASE("an EXR comes through the child bit for bit" * doctest::test_suite("images")) {
    if (!test::have_images()) return;
    const Exr exr;
    const auto planes = exr.decode();
    REQUIRE_MESSAGE(planes.has_value(), (planes ? "" : planes.error().message));
    REQUIRE(planes->size() == 3);
    CHECK((*planes)[0] == exr.ids);
    for (std::size_t i = 0; i < exr.depth.size(); ++i) {
        CHECK((*planes)[1][i] == std::bit_cast<std::uint32_t>(exr.depth[i]));
        CHECK((*planes)[2][i] == std::bit_cast<std::uint32_t>(exr.depth[i]));
    }
}

TEST_CASE("an EXR with another header starts no child" * doctest::test_suite("images")) {
    if (!test::have_images()) return;
    Exr exr;
    // This child would be an error of its own.
    const auto refusal = [&](std::uint32_t width, std::uint32_t height) {
        const auto planes =
            decode_exr_in_child(exr.bytes, width, height, exr.types, {}, child("--crash"));
        REQUIRE_FALSE(planes.has_value());
        return planes.error().message;
    };
    CHECK(test::contains(refusal(exr_height, exr_width), "the EXR has 6x4 pixels, not 4x6"));
    for (const ChannelType& other : {ChannelType{"A", true}, ChannelType{"Z", false}}) {
        exr.types[2] = other;
        CHECK(test::contains(refusal(exr_width, exr_height), "other channels"));
    }
    exr.types.pop_back();
    CHECK(test::contains(refusal(exr_width, exr_height), "other channels"));
    exr.types = {{"R", true}, {"R", true}, {"Z", true}};
    CHECK_FALSE(exr.decode().has_value());
    exr.bytes.resize(100);
    CHECK(test::contains(refusal(exr_width, exr_height), "cut short"));
}

TEST_CASE("a damaged EXR, or a child that misbehaves over one, is an error" *
          doctest::test_suite("images")) {
    if (!test::have_images()) return;
    Exr exr;
    CHECK(test::contains(exr.why_not("--crash"), "reading 'the EXR' ended the import process"));
    CHECK(test::contains(exr.why_not("--junk"), "incomplete result"));
    // Equally many bytes, in another form.
    CHECK(test::contains(exr.why_not("--transposed"), "incomplete result"));
    CHECK(test::contains(exr.why_not("--regrouped"), "incomplete result"));
    ImportLimits limits;
    limits.time_max = std::chrono::seconds(1);
    CHECK(test::contains(exr.why_not("--hang", limits), "longer than 1 s"));
    if (!test::sanitized) {
        limits = {};
        limits.bytes_max = 128ULL << 20;
        CHECK(exr.decode("--import-child", limits).error().code == ErrorCode::out_of_memory);
    }
    exr.bytes.resize(exr.bytes.size() - 60);
    CHECK(test::contains(exr.why_not("--import-child"), "damaged or cut short"));
}
