#include "client/requests/generator.h"

#include <doctest/doctest.h>

#include <string>
#include <utility>
#include <vector>

using namespace raynest;
using client::Generate;
using client::parse_generate;
using protocol::Exit;

namespace {

using Words = std::vector<std::string>;

Generate parsed(const std::vector<std::string>& words) {
    auto generate = parse_generate(words);
    REQUIRE_MESSAGE(generate.has_value(), (generate ? "" : generate.error().message));
    return std::move(*generate);
}

std::string generator_complaint(const std::vector<std::string>& words) {
    const auto generate = parse_generate(words);
    REQUIRE_FALSE(generate.has_value());
    CHECK(generate.error().exit == Exit::usage);
    return generate.error().message;
}

bool mentions(const std::string& text, const std::string& what) {
    return text.find(what) != std::string::npos;
}

}  // namespace

TEST_CASE("words go to the daemon as they are") {
    const wire::GeneratorT image = parsed({"fish", "size=8x6", "fx=5", "fin=1x1"}).at({});
    CHECK(image.kind == "fish");
    CHECK(image.settings == Words{"size=8x6", "fx=5", "fin=1x1"});
}

TEST_CASE("places are shifted by the scene's origin, in float64") {
    const client::WorldPoint origin{4e6, 5e6, 100};
    const Generate posed = parsed({"lidar", "pose=1,0,0,4000000.25,0,1,0,5000000,0,0,1,109"});
    CHECK(posed.at({}).settings == Words{"pose=1,0,0,4000000.25,0,1,0,5e+06,0,0,1,109"});
    CHECK(posed.at(origin).settings == Words{"pose=1,0,0,0.25,0,1,0,0,0,0,1,9"});
    const Generate looking =
        parsed({"camera", "lookat=4000001,5000002,103,4000000,5000000,100,0,0,1"});
    CHECK(looking.at(origin).settings == Words{"lookat=1,2,3,0,0,0,0,0,1"});
}

TEST_CASE("a sensor without a place stands where the world begins") {
    const client::WorldPoint origin{1, 2, 3};
    CHECK(parsed({"lidar"}).at({}).settings.empty());
    CHECK(parsed({"lidar"}).at(origin).settings == Words{"pose=1,0,0,-1,0,1,0,-2,0,0,1,-3"});
    CHECK(parsed({"lidar", "camera=0"}).at(origin).settings == Words{"camera=0"});
    CHECK(parsed({"camera"}).at(origin).settings.empty());
    CHECK(parsed({"hemisphere"}).at(origin).settings.empty());
}

TEST_CASE("the file of points stays here") {
    const Generate generate = parsed({"hemisphere", "points=p.npy", "samples=9"});
    CHECK(generate.points == "p.npy");
    CHECK(generate.at({}).settings == Words{"points=", "samples=9"});
}

TEST_CASE("what is no key=value or no place is named") {
    CHECK(generator_complaint({"camera", "size"}) == "'size' is not key=value");
    CHECK(mentions(generator_complaint({}), "needs a kind"));
    for (const std::string bad : {"lookat=1,2,3", "pose=1,2,3", "pose=a"}) {
        const std::string message = generator_complaint({"pinhole", bad});
        CHECK_MESSAGE(message.starts_with(bad.substr(0, bad.find('=')) + ": "), message);
    }
    const std::string pose = "pose=1,0,0,0,0,1,0,0,0,0,1,0";
    CHECK(generator_complaint({"pinhole", pose, pose}) == "pose is given twice");
    for (const std::string word : {"fx=1", "points=a.npy", "trajectory=a.npy"})
        CHECK(generator_complaint({"sweep", word, word}) ==
              word.substr(0, word.find('=')) + " is given twice");
}

TEST_CASE("the help names every kind with its keys, and every key") {
    const std::string help = client::generate_help();
    for (const char* line :
         {"  pinhole           size, camera, lookat, pose, fx, fy, cx, cy, range\n",
          "  seed              seed of the random numbers (0)\n"})
        CHECK(mentions(help, line));
}
