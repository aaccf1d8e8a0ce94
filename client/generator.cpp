#include "client/generator.h"

#include "client/numbers.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <set>
#include <utility>
#include <vector>

namespace raynest::client {
namespace {

using Numbers = std::vector<float>;

tl::unexpected<Failure> misshapen(const std::string& text, const char* shape) {
    return fail(Exit::usage, "'" + text + "' is not " + shape);
}

/// A whole number that a float holds exactly or an integer type holds at all.
template <class Whole>
Result<void> read_whole(const std::string& text, Whole& value) {
    const char* const last = text.data() + text.size();
    const auto [end, error] = std::from_chars(text.data(), last, value);
    if (error != std::errc{} || end != last) return misshapen(text, "a whole number");
    return {};
}

Result<void> read_number(const std::string& text, float& value) {
    const auto numbers = parse_numbers(text, 1, 1, "a number");
    if (!numbers) return tl::unexpected<Failure>(numbers.error());
    value = numbers->front();
    return {};
}

Result<void> read_list(const std::string& text, Numbers& list) {
    auto numbers = parse_numbers(text, "numbers separated by commas");
    if (!numbers) return tl::unexpected<Failure>(numbers.error());
    list = std::move(*numbers);
    return {};
}

/// "first:last:count" as three numbers; false where the text has no colon.
Result<bool> read_range(const std::string& text, Numbers& range, std::uint32_t& count) {
    const std::vector<std::string> parts = split(text, ':');
    if (parts.size() == 1) return false;
    if (parts.size() != 3) return misshapen(text, "FIRST:LAST:COUNT");
    auto ends = parse_numbers(parts[0] + "," + parts[1], 2, 2, "FIRST:LAST:COUNT");
    if (!ends) return tl::unexpected<Failure>(ends.error());
    if (auto read = read_whole(parts[2], count); !read)
        return tl::unexpected<Failure>(read.error());
    range = std::move(*ends);
    return true;
}

Result<void> read_size(Generate& to, const std::string& text) {
    const std::vector<std::string> parts = split(text, 'x');
    if (parts.size() != 2) return misshapen(text, "WIDTHxHEIGHT");
    if (auto width = read_whole(parts[0], to.message.width); !width) return width;
    return read_whole(parts[1], to.message.height);
}

Result<void> read_window(Generate& to, const std::string& text) {
    const auto numbers = parse_numbers(text, "WIDTHxHEIGHT", 'x');
    if (!numbers) return tl::unexpected<Failure>(numbers.error());
    if (numbers->size() != 2) return misshapen(text, "WIDTHxHEIGHT");
    to.message.window_width = numbers->front();
    to.message.window_height = numbers->back();
    return {};
}

wire::CameraT& camera_of(Generate& to) {
    if (to.message.camera == nullptr) to.message.camera = std::make_unique<wire::CameraT>();
    return *to.message.camera;
}

Result<void> read_look_at(Generate& to, const std::string& text) {
    const auto v = parse_numbers(text, 6, 9, "ex,ey,ez,ax,ay,az[,ux,uy,uz]");
    if (!v) return tl::unexpected<Failure>(v.error());
    const auto vector = [&](std::size_t at) {
        return std::make_unique<wire::Vec3>((*v)[at], (*v)[at + 1], (*v)[at + 2]);
    };
    wire::CameraT& camera = camera_of(to);
    camera.look_at = true;
    camera.eye = vector(0);
    camera.at = vector(3);
    camera.up = v->size() == 9 ? vector(6) : std::make_unique<wire::Vec3>(0.0F, 1.0F, 0.0F);
    return {};
}

Result<void> read_pose(Generate& to, const std::string& text) {
    auto numbers = parse_numbers(text, 12, 12, "12 numbers, the rows of a 3x4 matrix");
    if (!numbers) return tl::unexpected<Failure>(numbers.error());
    to.message.pose = std::move(*numbers);
    return {};
}

Result<void> read_elevations(Generate& to, const std::string& text) {
    Numbers ends;
    std::uint32_t count = 0;
    const auto range = read_range(text, ends, count);
    if (!range) return tl::unexpected<Failure>(range.error());
    if (!*range) return read_list(text, to.message.elevations);
    constexpr std::uint32_t channels_max = 512;  // what a message may hold
    if (count < 2 || count > channels_max) return misshapen(text, "a range of 2 to 512 channels");
    const double step = (static_cast<double>(ends[1]) - static_cast<double>(ends[0])) / (count - 1);
    for (std::uint32_t i = 0; i < count; ++i)
        to.message.elevations.push_back(
            static_cast<float>(static_cast<double>(ends[0]) + step * i));
    return {};
}

Result<void> read_azimuths(Generate& to, const std::string& text) {
    Numbers ends;
    const auto range = read_range(text, ends, to.message.azimuth_count);
    if (!range) return tl::unexpected<Failure>(range.error());
    if (!*range) return misshapen(text, "START:STOP:COUNT");
    to.message.azimuth_start = ends[0];
    to.message.azimuth_stop = ends[1];
    return {};
}

Result<void> read_origin_offsets(Generate& to, const std::string& text) {
    Numbers list;
    if (auto read = read_list(text, list); !read) return read;
    if (list.size() % 3 != 0) return misshapen(text, "three numbers per channel");
    for (std::size_t i = 0; i < list.size(); i += 3)
        to.message.origin_offsets.emplace_back(list[i], list[i + 1], list[i + 2]);
    return {};
}

Result<void> read_bounds(Generate& to, const std::string& text) {
    const auto numbers = parse_numbers(text, "NEAR:FAR", ':');
    if (!numbers) return tl::unexpected<Failure>(numbers.error());
    if (numbers->size() != 2) return misshapen(text, "NEAR:FAR");
    to.message.tmin = numbers->front();
    to.message.tmax = std::isinf(numbers->back()) ? 0.0F : numbers->back();
    return {};
}

template <float wire::GeneratorT::*member>
Result<void> read_member(Generate& to, const std::string& text) {
    return read_number(text, to.message.*member);
}

struct Key {
    std::string_view name;
    std::string_view text;
    Result<void> (*read)(Generate&, const std::string&);
};
constexpr std::array keys = {
    Key{"size", "pixels, WIDTHxHEIGHT (960x540); all but lidar and hemisphere", read_size},
    Key{"camera", "name or index of a camera of the scene",
        [](Generate& to, const std::string& text) -> Result<void> {
            camera_of(to).name = text;
            return {};
        }},
    Key{"lookat", "ex,ey,ez,ax,ay,az[,ux,uy,uz]: eye, point looked at, up", read_look_at},
    Key{"pose", "sensor to world, 12 numbers, row by row, instead", read_pose},
    Key{"fov", "camera: vertical angle of view in degrees",
        [](Generate& to, const std::string& text) {
            return read_number(text, camera_of(to).fov_degrees);
        }},
    Key{"fx", "pinhole: focal length in pixels", read_member<&wire::GeneratorT::fx>},
    Key{"fy", "pinhole: the vertical one (fx)", read_member<&wire::GeneratorT::fy>},
    Key{"cx", "pinhole: principal point (the middle)", read_member<&wire::GeneratorT::cx>},
    Key{"cy", "pinhole", read_member<&wire::GeneratorT::cy>},
    Key{"window", "orthographic: WIDTHxHEIGHT in the scene", read_window},
    Key{"elevations", "lidar: degrees of each channel, a,b,... or LOWEST:HIGHEST:COUNT",
        read_elevations},
    Key{"azimuths", "lidar: degrees START:STOP:COUNT, counter-clockwise, without the last",
        read_azimuths},
    Key{"azimuth_offsets", "lidar: degrees, one per channel",
        [](Generate& to, const std::string& text) {
            return read_list(text, to.message.azimuth_offsets);
        }},
    Key{"origin_offsets", "lidar: x,y,z per channel, turning with the head", read_origin_offsets},
    Key{"range", "NEAR:FAR (0:inf)", read_bounds},
    Key{"points", "hemisphere: FILE.npy of shape (N, 6): points and normals",
        [](Generate& to, const std::string& text) -> Result<void> {
            to.points = text;
            return {};
        }},
    Key{"samples", "hemisphere: rays per point (64)",
        [](Generate& to, const std::string& text) { return read_whole(text, to.message.samples); }},
    Key{"seed", "hemisphere: of the random numbers (0)",
        [](Generate& to, const std::string& text) { return read_whole(text, to.message.seed); }},
};

/// What the keys left open.
Result<void> complete(Generate& to, const std::set<std::string, std::less<>>& given) {
    wire::GeneratorT& message = to.message;
    const bool points = message.kind == "hemisphere";
    if (points != given.contains("points"))
        return fail(Exit::usage,
                    points ? "hemisphere needs points=FILE.npy"
                           : "points= is for hemisphere; " + message.kind + " makes its own");
    if (!given.contains("size") && message.kind != "lidar" && !points) {
        message.width = 960;
        message.height = 540;
    }
    if (!given.contains("fy")) message.fy = message.fx;
    if (!given.contains("cx")) message.cx = 0.5F * static_cast<float>(message.width);
    if (!given.contains("cy")) message.cy = 0.5F * static_cast<float>(message.height);
    return {};
}

}  // namespace

Result<Generate> parse_generate(std::span<const std::string> words) {
    if (words.empty()) return fail(Exit::usage, "--generate needs a kind");
    Generate generate;
    generate.message.kind = words.front();
    std::set<std::string, std::less<>> given;
    for (const std::string& word : words.subspan(1)) {
        const std::size_t equals = word.find('=');
        const std::string name = word.substr(0, equals);
        const auto* key = std::find_if(keys.begin(), keys.end(),
                                       [&](const Key& each) { return each.name == name; });
        if (equals == std::string::npos || key == keys.end()) {
            std::string known;
            for (const Key& each : keys)
                known += (known.empty() ? "" : ", ") + std::string(each.name);
            return fail(Exit::usage,
                        "'" + word + "' is not key=value of a generator; keys are " + known);
        }
        if (!given.insert(name).second) return fail(Exit::usage, name + " is given twice");
        if (auto read = key->read(generate, word.substr(equals + 1)); !read)
            return fail(Exit::usage, name + ": " + read.error().message);
    }
    if (auto whole = complete(generate, given); !whole)
        return tl::unexpected<Failure>(whole.error());
    return generate;
}

std::string generate_help() {
    std::string help = "\nKeys of --generate:\n";
    for (const Key& key : keys)
        help += "  " + std::string(key.name) + "=" +
                std::string(18 - std::min<std::size_t>(17, key.name.size()), ' ') +
                std::string(key.text) + "\n";
    return help;
}

}  // namespace raynest::client
