#include "server/requests/words/generator.h"

#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cmath>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

using namespace raynest;
using server::Code;
using server::Generated;

namespace {

using Words = std::vector<std::string>;

const Snapshot& scene() {
    static const auto built = test::build_scene(test::tree_scene());
    return *built;
}

server::Reply<Generated> generated(const std::string& kind, const Words& settings) {
    wire::GeneratorT message;
    message.kind = kind;
    message.settings = settings;
    flatbuffers::FlatBufferBuilder builder;
    builder.Finish(wire::Generator::Pack(builder, &message));
    return server::generate(*flatbuffers::GetRoot<wire::Generator>(builder.GetBufferPointer()),
                            scene());
}

template <class Kind>
Kind sensor(const std::string& kind, const Words& settings) {
    const auto made = generated(kind, settings);
    REQUIRE_MESSAGE(made.has_value(), (made ? "" : made.error().message));
    return std::get<Kind>(std::get<server::SensorPointer>(*made)->get());
}

std::string complaint(const std::string& kind, const Words& settings,
                      Code code = Code::invalid_field) {
    const auto made = generated(kind, settings);
    REQUIRE_FALSE(made.has_value());
    CHECK(made.error().code == code);
    return made.error().message;
}

bool mentions(const std::string& text, const std::string& what) {
    return text.find(what) != std::string::npos;
}

const std::string pose = "pose=1,0,0,0,0,1,0,0,0,0,1,9", look_at = "lookat=1,2,3,4,5,6";

}  // namespace

TEST_CASE("an image has a size, and a pinhole square pixels and its axis in the middle") {
    const auto image = sensor<Pinhole>("pinhole", {"fx=500"});
    CHECK(image.size.width == 960);
    CHECK(image.size.height == 540);
    CHECK(image.center_x == 480);
    CHECK(image.center_y == 270);
    const auto other = sensor<Pinhole>("pinhole", {"size=8x6", "fx=5", "fy=6", "cx=0"});
    CHECK(other.size.width == 8);
    CHECK(other.center_x == 0);
    CHECK(other.center_y == 3);
}

TEST_CASE("a lidar's channels are a list or an evenly divided range") {
    const auto range =
        sensor<Lidar>("lidar", {"elevations=-15:15:4", "azimuths=0:180:90", "range=0.5:inf"});
    CHECK(range.rays().width == 90);
    CHECK(range.rays().height == 4);
    CHECK(range.ray(0, 0).tmin == 0.5F);
    CHECK(static_cast<double>(range.ray(0, 0).direction.z) ==
          doctest::Approx(std::sin(-15 * M_PI / 180)));
    CHECK(static_cast<double>(range.ray(0, 1).direction.z) ==
          doctest::Approx(std::sin(-5 * M_PI / 180)));
    const auto list = sensor<Lidar>("lidar", {"elevations=1,2.5", "azimuths=0:9:9",
                                              "origin_offsets=1,2,3,4,5,6", "range=0:30"});
    CHECK(list.ray(0, 1).origin == Vec3(4, 5, 6));
    CHECK(list.ray(0, 0).tmax == 30);
}

TEST_CASE("a sensor stands where a camera, a look-at or a pose says") {
    const Words sweep = {"elevations=0", "azimuths=0:1:1"};
    const auto at = [&](const std::string& place) {
        Words words = sweep;
        if (!place.empty()) words.push_back(place);
        return sensor<Lidar>("lidar", words).ray(0, 0).origin;
    };
    CHECK(at("") == Vec3(0));
    CHECK(at(pose) == Vec3(0, 0, 9));
    CHECK(at(look_at) == Vec3(1, 2, 3));
    CHECK(mentions(complaint("lidar", {pose, look_at}), "lookat and pose each say where"));
    CHECK(mentions(complaint("lidar", {"camera=1", pose}), "camera and pose each say where"));
    CHECK(mentions(complaint("camera", {look_at, "camera=1"}), "camera and lookat each say where"));
    CHECK(mentions(complaint("camera", {"camera=unheard"}), "camera"));
}

TEST_CASE("a pose turns and moves; one that scales, shears or mirrors is refused by name") {
    const Words sweep = {"elevations=0", "azimuths=0:1:1"};
    const auto with = [&](const std::string& place) {
        Words words = sweep;
        words.push_back(place);
        return words;
    };
    for (const auto& [place, says] : std::vector<std::pair<std::string, std::string>>{
             {"pose=2,0,0,0,0,2,0,0,0,0,2,0",
              "pose: it scales, its axes have the lengths 2, 2 and 2"},
             {"pose=1,0,0,0,0,1,0,0,0,0,0,0", "lengths 1, 1 and 0"},
             {"pose=1,0,0,0,0,1,0,0,0,0,-1,0", "pose: it mirrors"},
             {"pose=1,0.6,0,0,0,0.8,0,0,0,0,1,0", "pose: its axes are not at right angles"}})
        CHECK(mentions(complaint("lidar", with(place)), says));
    CHECK(mentions(complaint("pinhole", {"fx=9", "pose=3,0,0,0,0,3,0,0,0,0,3,0"}),
                   "pose: it scales"));
    // Digits as people write them are turns still.
    CHECK(generated("lidar", with("pose=0.707,-0.707,0,1,0.707,0.707,0,2,0,0,1,3")).has_value());
}

TEST_CASE("a lidar stands upright where a camera or a look-at says, whatever their pitch") {
    const auto ahead = [&](const std::string& place) {
        return sensor<Lidar>("lidar", {"elevations=0,90", "azimuths=0:360:4", place});
    };
    const auto near = [](const Vec3& a, const Vec3& b) { return glm::length(a - b) < 1e-6F; };
    // 45 degrees down along -z, with y up; down along x with z up; along -y with -z up; and
    // straight along the up vector, where ahead is any level way.
    for (const auto& [place, x, z] : std::vector<std::tuple<std::string, Vec3, Vec3>>{
             {"lookat=0,9,0,0,0,-9", {0, 0, -1}, {0, 1, 0}},
             {"lookat=0,0,2,5,0,0,0,0,1", {1, 0, 0}, {0, 0, 1}},
             {"lookat=0,9,0,0,0,0,0,0,-1", {0, -1, 0}, {0, 0, -1}},
             {"lookat=0,0,9,0,0,0,0,0,7", {0, 0, 0}, {0, 0, 1}}}) {
        CAPTURE(place);
        const Lidar lidar = ahead(place);
        const Vec3 first = lidar.ray(0, 0).direction;
        CHECK(near(lidar.ray(0, 1).direction, z));
        CHECK(std::abs(glm::dot(first, z)) < 1e-6F);
        CHECK(near(lidar.ray(1, 0).direction, glm::cross(z, first)));
        if (x != Vec3(0)) CHECK(near(first, x));
    }
}

TEST_CASE("settings keep the digits of float64 until a ray is rounded") {
    const auto after = [](double turns) {
        const double start = 360 * turns + 12.3;
        return sensor<Lidar>("lidar", {"elevations=0", "azimuths=" + std::to_string(start) + ":" +
                                                           std::to_string(start + 360) + ":1"})
            .ray(0, 0)
            .direction;
    };
    for (const double turns : {1e4, 1e5, 1e6}) CHECK(glm::length(after(turns) - after(0)) < 2e-7F);
    const auto place = sensor<Pinhole>("pinhole", {"fx=9", "pose=1,0,0,0.1,0,1,0,0,0,0,1,0"});
    CHECK(place.sensor_pose.pose.origin.x == 0.1);
    CHECK(mentions(complaint("pinhole", {"fx=1e-60"}), "not a number"));
}

TEST_CASE("a hemisphere has samples and a seed") {
    const auto made =
        generated("hemisphere", {"points=", "samples=9", "seed=18446744073709551615"});
    REQUIRE(made.has_value());
    CHECK(std::get<Hemisphere>(*made).samples == 9);
    CHECK(std::get<Hemisphere>(*made).seed == ~0ULL);
    CHECK(std::get<Hemisphere>(*generated("hemisphere", {})).samples == 64);
}

TEST_CASE("a key that its kind has not is refused with those that it has") {
    CHECK(complaint("camera", {"zoom=2"}) ==
          "zoom is no key of camera; its keys are size, camera, lookat, fov, range");
    for (const auto& [kind, word] :
         std::vector<std::pair<std::string, std::string>>{{"camera", pose},
                                                          {"camera", "fx=5"},
                                                          {"camera", "points="},
                                                          {"pinhole", "fov=50"},
                                                          {"pinhole", "window=1x1"},
                                                          {"orthographic", "samples=1"},
                                                          {"equirectangular", "fov=90"},
                                                          {"lidar", "size=8x8"},
                                                          {"hemisphere", "range=0:1"},
                                                          {"hemisphere", look_at}}) {
        const std::string name = word.substr(0, word.find('='));
        CHECK(
            mentions(complaint(kind, {word}), name + " is no key of " + kind + "; its keys are "));
    }
    CHECK(mentions(complaint("fish", {}), "no generator 'fish'; there are camera, pinhole"));
}

TEST_CASE("what a kind lacks is named") {
    for (const auto& [kind, says] : std::vector<std::pair<std::string, std::string>>{
             {"pinhole", "generator pinhole needs fx and fy above 0"},
             {"orthographic", "generator orthographic needs window=WIDTHxHEIGHT, both above 0"},
             {"lidar", "generator lidar needs elevations and azimuths"}})
        CHECK(complaint(kind, {}) == says);
    CHECK(mentions(complaint("lidar", {"elevations=0,1", "azimuths=0:1:1", "azimuth_offsets=1"}),
                   "azimuth_offsets must be as many as elevations"));
    CHECK(mentions(complaint("lidar", {"elevations=0,1", "azimuths=0:1:1", "origin_offsets=1,2,3"}),
                   "origin_offsets must be as many as elevations"));
}

TEST_CASE("rays that would end at 0 are refused") {
    for (const char* range : {"range=0:0", "range=5:-0"})
        CHECK(mentions(complaint("lidar", {range}), "cannot end at 0"));
    CHECK(mentions(complaint("lidar", {"range=5:1"}), "0 <= tmin <= tmax"));
}

TEST_CASE("what is misshapen, too much or twice there is named") {
    CHECK(complaint("camera", {"fov=1", "fov=2"}) == "fov is given twice");
    for (const auto& [kind, words] : std::vector<std::pair<std::string, Words>>{
             {"camera",
              {"size=5", "size=5x", "size=-1x2", "size=1x2x3", "fov=", "fov=1,2", "fov=1e99",
               "fov=180", "fov=nan", "lookat=1,2,3", "lookat=1,2,3,4,5,6,7", "range=1",
               "range=nan:1", "range=inf:inf"}},
             {"pinhole", {"pose=1,2,3", "pose=1,0,0,0,0,1,0,0,0,0,1,inf", "fx=a", "fx=inf"}},
             {"orthographic", {"window=1", "window=1xnan"}},
             {"lidar",
              {"elevations=1:2", "elevations=0:1:1", "elevations=0:1:513", "elevations=0,nan",
               "azimuths=5", "azimuths=0:1:x", "azimuths=0:1:0", "azimuths=0:1:65537",
               "origin_offsets=1,2"}},
             {"hemisphere",
              {"samples=-1", "samples=0", "samples=65537", "samples=4294967296", "seed=1.5"}}})
        for (const std::string& bad : words) {
            const std::string message = complaint(kind, {bad});
            const std::string key = bad.substr(0, bad.find('='));
            CHECK_MESSAGE(message.starts_with(key + ": "), bad << ": " << message);
        }
    for (const char* const bad : {"size=4294967296x1", "size=0x1", "size=1x16385"})
        CHECK(mentions(complaint("camera", {bad}), "is not a whole number from 1 to 16384"));
    CHECK(mentions(complaint("camera", {"size=16384x16384"}, Code::limit_exceeded),
                   "picture_pixels_max"));
    std::string many = "elevations=0";
    for (int i = 0; i < 512; ++i) many += ",0";
    CHECK(mentions(complaint("lidar", {many}, Code::limit_exceeded), "list_items_max"));
}

TEST_CASE("a part lies within the rays of a sensor, and is of the points that were sent") {
    const auto source = [](const std::string& kind, const Words& settings, std::uint64_t first,
                           std::uint64_t count, std::uint64_t sent = 0) {
        wire::QueryT query;
        query.generator = std::make_unique<wire::GeneratorT>();
        query.generator->kind = kind;
        query.generator->settings = settings;
        query.part_first = first;
        query.part_count = count;
        query.ray_count = sent;
        flatbuffers::FlatBufferBuilder builder;
        builder.Finish(wire::Query::Pack(builder, &query));
        return server::read_rays(*flatbuffers::GetRoot<wire::Query>(builder.GetBufferPointer()),
                                 scene());
    };
    const Words small = {"size=10x10"};
    CHECK(source("camera", small, 0, 0)->rays() == 100);
    CHECK(source("camera", small, 30, 0)->rays() == 70);
    CHECK(source("camera", small, 30, 20)->rays() == 20);
    CHECK(source("camera", small, 99, 1)->rays() == 1);
    const std::vector<std::pair<std::uint64_t, std::uint64_t>> too_far = {
        {100, 0}, {99, 2}, {0, 101}, {1ULL << 36, 1}};
    for (const auto& [first, count] : too_far) {
        const auto beyond = source("camera", small, first, count);
        REQUIRE_FALSE(beyond.has_value());
        CHECK(mentions(beyond.error().message, "but the generator makes 100"));
    }
    CHECK(source("hemisphere", {"samples=4"}, 1000, 5, 5)->rays() == 20);
    const auto other = source("hemisphere", {"samples=4"}, 1000, 6, 5);
    REQUIRE_FALSE(other.has_value());
    CHECK(mentions(other.error().message, "send the points of the part alone"));
}
