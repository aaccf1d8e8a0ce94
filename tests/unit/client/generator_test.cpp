#include "client/generator.h"

#include <doctest/doctest.h>

#include <string>
#include <utility>
#include <vector>

using namespace raynest;
using client::Generate;
using client::parse_generate;
using protocol::Exit;

namespace {

Generate parsed(const std::vector<std::string>& words) {
    auto generate = parse_generate(words);
    REQUIRE_MESSAGE(generate.has_value(), (generate ? "" : generate.error().message));
    return std::move(*generate);
}

std::string complaint(const std::vector<std::string>& words) {
    const auto generate = parse_generate(words);
    REQUIRE_FALSE(generate.has_value());
    CHECK(generate.error().exit == Exit::usage);
    return generate.error().message;
}

bool mentions(const std::string& text, const std::string& what) {
    return text.find(what) != std::string::npos;
}

}  // namespace

TEST_CASE("an image has a size, and a pinhole square pixels and its axis in the middle") {
    const wire::GeneratorT image = parsed({"pinhole", "fx=500"}).message;
    CHECK(image.kind == "pinhole");
    CHECK(image.width == 960);
    CHECK(image.height == 540);
    CHECK(image.fy == 500);
    CHECK(image.cx == 480);
    CHECK(image.cy == 270);
    const wire::GeneratorT other = parsed({"pinhole", "size=8x6", "fx=5", "fy=6", "cx=0"}).message;
    CHECK(other.width == 8);
    CHECK(other.fy == 6);
    CHECK(other.cx == 0);
    CHECK(other.cy == 3);
}

TEST_CASE("a lidar's channels are a list or an evenly divided range") {
    const wire::GeneratorT range = parsed({"lidar", "elevations=-15:15:4", "azimuths=0:180:90",
                                           "origin_offsets=1,2,3,4,5,6", "range=0.5:inf"})
                                       .message;
    CHECK(range.width == 0);
    CHECK(range.elevations == std::vector<float>{-15, -5, 5, 15});
    CHECK(range.azimuth_stop == 180);
    CHECK(range.azimuth_count == 90);
    REQUIRE(range.origin_offsets.size() == 2);
    CHECK(range.origin_offsets[1].z() == 6);
    CHECK(range.tmin == 0.5F);
    CHECK(range.tmax == 0);
    const wire::GeneratorT list = parsed({"lidar", "elevations=1,2.5", "range=0:30"}).message;
    CHECK(list.elevations == std::vector<float>{1, 2.5F});
    CHECK(list.tmax == 30);
}

TEST_CASE("a sensor stands where a camera, a look-at or a pose says") {
    CHECK(parsed({"camera"}).message.camera == nullptr);
    CHECK(parsed({"camera", "camera=side", "fov=20"}).message.camera->name == "side");
    const auto look_at = parsed({"equirectangular", "lookat=1,2,3,4,5,6"}).at({});
    CHECK(look_at.camera->look_at);
    CHECK(look_at.camera->at->z() == 6);
    CHECK(look_at.camera->up->y() == 1);
    CHECK(parsed({"lidar", "pose=1,0,0,0,0,1,0,0,0,0,1,9"}).at({}).pose.back() == 9);
}

TEST_CASE("a hemisphere has points, samples and a seed; nothing else has points") {
    const Generate generate =
        parsed({"hemisphere", "points=p.npy", "samples=9", "seed=18446744073709551615"});
    CHECK(generate.points == "p.npy");
    CHECK(generate.message.samples == 9);
    CHECK(generate.message.seed == ~0ULL);
    CHECK(mentions(complaint({"hemisphere"}), "needs points=FILE.npy"));
    CHECK(mentions(complaint({"camera", "points=p.npy"}), "points is no key of camera"));
}

TEST_CASE("a key that its kind has not is refused with those that it has") {
    CHECK(complaint({"camera", "zoom=2"}) ==
          "zoom is no key of camera; its keys are size, camera, lookat, fov, range");
    const std::string pose = "pose=1,0,0,0,0,1,0,0,0,0,1,0";
    for (const auto& [kind, word] :
         std::vector<std::pair<std::string, std::string>>{{"camera", pose},
                                                          {"camera", "fx=5"},
                                                          {"pinhole", "fov=50"},
                                                          {"pinhole", "window=1x1"},
                                                          {"orthographic", "samples=1"},
                                                          {"equirectangular", "fov=90"},
                                                          {"lidar", "size=8x8"},
                                                          {"hemisphere", "range=0:1"},
                                                          {"hemisphere", "lookat=1,2,3,4,5,6"}}) {
        const std::string name = word.substr(0, word.find('='));
        CHECK(
            mentions(complaint({kind, word}), name + " is no key of " + kind + "; its keys are "));
    }
    CHECK(mentions(complaint({"fish"}), "no generator 'fish'; there are camera, pinhole"));
}

TEST_CASE("a sensor stands at one place") {
    const std::string pose = "pose=1,0,0,0,0,1,0,0,0,0,1,0", look_at = "lookat=1,2,3,4,5,6";
    CHECK(mentions(complaint({"lidar", pose, look_at}), "lookat and pose each say where"));
    CHECK(mentions(complaint({"lidar", "camera=1", pose}), "camera and pose each say where"));
    CHECK(mentions(complaint({"camera", look_at, "camera=1"}), "camera and lookat each say where"));
}

TEST_CASE("rays that would end at 0 are refused, for on the wire that means no end") {
    for (const char* range : {"range=0:0", "range=5:-0"})
        CHECK(mentions(complaint({"lidar", range}), "cannot end at 0"));
}

TEST_CASE("what is no key, twice there or misshapen is named") {
    CHECK(mentions(complaint({"camera", "size"}), "'size' is not key=value"));
    CHECK(mentions(complaint({"camera", "fov=1", "fov=2"}), "fov is given twice"));
    using Words = std::vector<std::string>;
    for (const auto& [kind, words] : std::vector<std::pair<std::string, Words>>{
             {"camera",
              {"size=5", "size=5x", "size=-1x2", "size=1x2x3", "fov=", "fov=1,2", "fov=1e99",
               "lookat=1,2,3", "range=1"}},
             {"pinhole", {"pose=1,2,3", "fx=a"}},
             {"orthographic", {"window=1"}},
             {"lidar",
              {"elevations=1:2", "elevations=0:1:1", "elevations=0:1:513", "azimuths=5",
               "azimuths=0:1:x", "azimuths=0:1:65537", "origin_offsets=1,2"}},
             {"hemisphere", {"samples=-1", "samples=4294967296", "seed=1.5"}}})
        for (const std::string& bad : words) {
            const std::string message = complaint({kind, bad});
            const std::string key = bad.substr(0, bad.find('='));
            CHECK_MESSAGE(message.starts_with(key + ": "), bad << ": " << message);
        }
    for (const char* const bad : {"size=4294967296x1", "size=0x1", "size=1x16385"})
        CHECK(mentions(complaint({"camera", bad}), "is not a whole number from 1 to 16384"));
    CHECK(mentions(complaint({}), "needs a kind"));
}
