#include "client/generator.h"

#include "client/job.h"
#include "client/numbers.h"
#include "protocol/limits.h"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <limits>
#include <set>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest::client {
namespace {

using Numbers = std::vector<float>;

tl::unexpected<Failure> misshapen(const std::string& text, const char* shape) {
    return fail(Exit::usage, "'" + text + "' is not " + shape);
}

constexpr protocol::Limits limits;

template <class Whole>
Result<void> read_whole(const std::string& text, Whole& value, std::uint64_t least,
                        std::uint64_t most) {
    const char* const last = text.data() + text.size();
    const auto [end, error] = std::from_chars(text.data(), last, value);
    if (error == std::errc{} && end == last && value >= least && value <= most) return {};
    return fail(Exit::usage, "'" + text + "' is not a whole number from " + std::to_string(least) +
                                 " to " + std::to_string(most));
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
Result<bool> read_range(const std::string& text, Numbers& range, std::uint32_t& count,
                        std::uint64_t fewest, std::uint64_t most) {
    const std::vector<std::string> parts = split(text, ':');
    if (parts.size() == 1) return false;
    if (parts.size() != 3) return misshapen(text, "FIRST:LAST:COUNT");
    auto ends = parse_numbers(parts[0] + "," + parts[1], 2, 2, "FIRST:LAST:COUNT");
    if (!ends) return tl::unexpected<Failure>(ends.error());
    if (auto read = read_whole(parts[2], count, fewest, most); !read)
        return tl::unexpected<Failure>(read.error());
    range = std::move(*ends);
    return true;
}

Result<void> read_size(Generate& to, const std::string& text) {
    const std::vector<std::string> parts = split(text, 'x');
    if (parts.size() != 2) return misshapen(text, "WIDTHxHEIGHT");
    if (auto width = read_whole(parts[0], to.message.width, 1, limits.picture_side_max); !width)
        return width;
    return read_whole(parts[1], to.message.height, 1, limits.picture_side_max);
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
    auto numbers = parse_world(text, 6, 9, "ex,ey,ez,ax,ay,az[,ux,uy,uz]");
    if (!numbers) return tl::unexpected<Failure>(numbers.error());
    camera_of(to);
    to.look_at = std::move(*numbers);
    return {};
}

Result<void> read_pose(Generate& to, const std::string& text) {
    auto numbers = parse_world(text, 12, 12, "12 numbers, the rows of a 3x4 matrix");
    if (!numbers) return tl::unexpected<Failure>(numbers.error());
    to.pose = std::move(*numbers);
    return {};
}

Result<void> read_elevations(Generate& to, const std::string& text) {
    Numbers ends;
    std::uint32_t count = 0;
    const auto range = read_range(text, ends, count, 2, limits.list_items_max);
    if (!range) return tl::unexpected<Failure>(range.error());
    if (!*range) return read_list(text, to.message.elevations);
    const double step = (static_cast<double>(ends[1]) - static_cast<double>(ends[0])) / (count - 1);
    for (std::uint32_t i = 0; i < count; ++i)
        to.message.elevations.push_back(
            static_cast<float>(static_cast<double>(ends[0]) + step * i));
    return {};
}

Result<void> read_azimuths(Generate& to, const std::string& text) {
    Numbers ends;
    const auto range = read_range(text, ends, to.message.azimuth_count, 1, limits.azimuths_max);
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
    // On the wire a tmax of 0 is none.
    if (numbers->back() == 0)
        return fail(Exit::usage, "a ray cannot end at 0; FAR is more than that, or inf");
    to.message.tmin = numbers->front();
    to.message.tmax =
        numbers->back() == std::numeric_limits<float>::infinity() ? 0.0F : numbers->back();
    return {};
}

template <float wire::GeneratorT::*member>
Result<void> read_member(Generate& to, const std::string& text) {
    return read_number(text, to.message.*member);
}

/// As bits, in the order of kind_names.
enum Kinds : unsigned {
    camera = 1,
    pinhole = 2,
    orthographic = 4,
    equirectangular = 8,
    lidar = 16,
    hemisphere = 32,
    images = camera | pinhole | orthographic | equirectangular,
    sensors = images | lidar
};
constexpr std::array<std::string_view, 6> kind_names = {
    "camera", "pinhole", "orthographic", "equirectangular", "lidar", "hemisphere"};

struct Key {
    std::string_view name;
    unsigned kinds;  ///< that have it
    std::string_view text;
    Result<void> (*read)(Generate&, const std::string&);
};
constexpr std::array keys = {
    Key{"size", images, "pixels, WIDTHxHEIGHT (960x540); all but lidar and hemisphere", read_size},
    Key{"camera", sensors, "name or index of a camera of the scene",
        [](Generate& to, const std::string& text) -> Result<void> {
            camera_of(to).name = text;
            return {};
        }},
    Key{"lookat", sensors, "ex,ey,ez,ax,ay,az[,ux,uy,uz], instead: eye, point looked at, up",
        read_look_at},
    Key{"pose", sensors & ~camera,
        "sensor to world, 12 numbers, row by row, instead (the identity); all but camera",
        read_pose},
    Key{"fov", camera, "vertical angle of view in degrees",
        [](Generate& to, const std::string& text) {
            return read_number(text, camera_of(to).fov_degrees);
        }},
    Key{"fx", pinhole, "focal length in pixels", read_member<&wire::GeneratorT::fx>},
    Key{"fy", pinhole, "the vertical one (fx)", read_member<&wire::GeneratorT::fy>},
    Key{"cx", pinhole, "principal point (the middle)", read_member<&wire::GeneratorT::cx>},
    Key{"cy", pinhole, "the vertical one (the middle)", read_member<&wire::GeneratorT::cy>},
    Key{"window", orthographic, "WIDTHxHEIGHT in the scene", read_window},
    Key{"elevations", lidar, "degrees of each channel, a,b,... or LOWEST:HIGHEST:COUNT",
        read_elevations},
    Key{"azimuths", lidar, "degrees START:STOP:COUNT, counter-clockwise, without the last",
        read_azimuths},
    Key{"azimuth_offsets", lidar, "degrees, one per channel",
        [](Generate& to, const std::string& text) {
            return read_list(text, to.message.azimuth_offsets);
        }},
    Key{"origin_offsets", lidar, "x,y,z per channel, turning with the head", read_origin_offsets},
    Key{"range", sensors, "NEAR:FAR (0:inf); all but hemisphere", read_bounds},
    Key{"points", hemisphere, "FILE.npy of shape (N, 6): points and normals",
        [](Generate& to, const std::string& text) -> Result<void> {
            to.points = text;
            return {};
        }},
    Key{"samples", hemisphere, "rays per point (64)",
        [](Generate& to, const std::string& text) {
            return read_whole(text, to.message.samples, 1, limits.samples_max);
        }},
    Key{"seed", hemisphere, "of the random numbers (0)",
        [](Generate& to, const std::string& text) {
            return read_whole(text, to.message.seed, 0, std::numeric_limits<std::uint64_t>::max());
        }},
};

/// The bit of a kind; 0 for a word that is none.
unsigned kind_of(std::string_view word) {
    for (std::size_t i = 0; i < kind_names.size(); ++i)
        if (kind_names[i] == word) return 1U << i;
    return 0;
}

template <class Names>
std::string listed(const Names& names, const char* between) {
    std::string list;
    for (const std::string_view name : names)
        list += (list.empty() ? "" : between) + std::string(name);
    return list;
}

std::vector<std::string_view> keys_of(unsigned kind) {
    std::vector<std::string_view> names;
    for (const Key& key : keys)
        if ((key.kinds & kind) != 0) names.push_back(key.name);
    return names;
}

using Given = std::set<std::string, std::less<>>;

/// What keys say of each other, and what they left open.
Result<void> complete(Generate& to, unsigned kind, const Given& given) {
    std::vector<std::string_view> places;
    for (const std::string_view place : {"camera", "lookat", "pose"})
        if (given.contains(place)) places.push_back(place);
    if (places.size() > 1)
        return fail(Exit::usage, listed(places, " and ") +
                                     " each say where the sensor stands: give one of them");
    if (kind == hemisphere && !given.contains("points"))
        return fail(Exit::usage, "hemisphere needs points=FILE.npy");
    wire::GeneratorT& message = to.message;
    if ((kind & images) != 0 && !given.contains("size")) {
        message.width = 960;
        message.height = 540;
    }
    if (!given.contains("fy")) message.fy = message.fx;
    if (!given.contains("cx")) message.cx = 0.5F * static_cast<float>(message.width);
    if (!given.contains("cy")) message.cy = 0.5F * static_cast<float>(message.height);
    return {};
}

}  // namespace

wire::GeneratorT Generate::at(const WorldPoint& origin) const {
    wire::GeneratorT placed = message;
    std::vector<double> matrix = pose;
    // Without a place it stands where the world begins.
    const bool is_sensor = (kind_of(message.kind) & (sensors & ~camera)) != 0;
    if (is_sensor && matrix.empty() && placed.camera == nullptr)
        matrix = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
    for (std::size_t i = 0; i < matrix.size(); ++i)
        placed.pose.push_back(static_cast<float>(matrix[i] - (i % 4 == 3 ? origin[i / 4] : 0)));
    if (placed.camera != nullptr) client::look_at(*placed.camera, look_at, origin);
    return placed;
}

Result<Generate> parse_generate(std::span<const std::string> words) {
    if (words.empty()) return fail(Exit::usage, "--generate needs a kind");
    const unsigned kind = kind_of(words.front());
    if (kind == 0)
        return fail(Exit::usage, "there is no generator '" + words.front() + "'; there are " +
                                     listed(kind_names, ", "));
    Generate generate;
    generate.message.kind = words.front();
    Given given;
    for (const std::string& word : words.subspan(1)) {
        const std::size_t equals = word.find('=');
        const std::string name = word.substr(0, equals);
        if (equals == std::string::npos)
            return fail(Exit::usage, "'" + word + "' is not key=value");
        const auto* key = std::find_if(keys.begin(), keys.end(), [&](const Key& each) {
            return each.name == name && (each.kinds & kind) != 0;
        });
        if (key == keys.end())
            return fail(Exit::usage, name + " is no key of " + words.front() + "; its keys are " +
                                         listed(keys_of(kind), ", "));
        if (!given.insert(name).second) return fail(Exit::usage, name + " is given twice");
        if (auto read = key->read(generate, word.substr(equals + 1)); !read)
            return fail(Exit::usage, name + ": " + read.error().message);
    }
    if (auto whole = complete(generate, kind, given); !whole)
        return tl::unexpected<Failure>(whole.error());
    return generate;
}

std::string generate_help() {
    std::string help = "\nKeys of --generate:\n";
    for (const Key& key : keys) {
        help += "  " + std::string(key.name) + "=" + std::string(18 - key.name.size(), ' ');
        if (std::has_single_bit(key.kinds))
            help += std::string(kind_names[static_cast<std::size_t>(std::countr_zero(key.kinds))]) +
                    ": ";
        help += std::string(key.text) + "\n";
    }
    return help;
}

}  // namespace raynest::client
