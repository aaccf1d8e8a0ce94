#include "server/handlers/generator.h"

#include "engine/integrators/camera.h"
#include "protocol/control.h"
#include "server/handlers/setting_types.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {
namespace {

struct GeneratorSettings {
#define RAYNEST_SETTING(name, type, text) std::optional<setting::type> name;
#include "protocol/generators.def"
};

/// The settings of a generator, and the values that most kinds derive from them.
struct Request {
    std::string_view kind;
    const GeneratorSettings& settings;
    const Snapshot& scene;
    SensorPose sensor_pose = {};
    ImageSize size = {960, 540};
};

tl::unexpected<protocol::Error> lacks(std::string_view kind, const char* what) {
    return refuse(Code::invalid_field, "generator " + std::string(kind) + " needs " + what);
}

Reply<Camera> camera_of(const Request& request) {
    const GeneratorSettings& given = request.settings;
    if (given.camera && request.scene.statistics().cameras.empty())
        return refuse(Code::invalid_field,
                      "the scene has no cameras: give the sensor a pose or a look-at instead");
    CameraRequest wanted;
    if (given.camera) wanted.name = given.camera->value;
    if (given.fov) wanted.fov_degrees = given.fov->value;
    if (const auto& look_at = given.lookat) {
        wanted.look_at = true;
        wanted.eye = look_at->vector(0);
        wanted.at = look_at->vector(1);
        if (look_at->values.size() == 9) wanted.up = look_at->vector(2);
    }
    auto camera = choose_camera(request.scene, wanted);
    if (!camera) return refuse(Code::invalid_field, camera.error().message);
    return std::move(*camera);
}

Reply<SensorPose> sensor_pose_of(const Request& request) {
    const GeneratorSettings& given = request.settings;
    std::vector<std::string> places;
    if (given.camera) places.emplace_back("camera");
    if (given.lookat) places.emplace_back("lookat");
    if (given.pose) places.emplace_back("pose");
    if (places.size() > 1)
        return refuse(Code::invalid_field,
                      places[0] + " and " + places[1] +
                          " each say where the sensor stands: give one of them");
    SensorPose sensor_pose;
    if (given.range) sensor_pose.tmin = given.range->tmin, sensor_pose.tmax = given.range->tmax;
    if (given.pose) {
        Transform to_world;
        std::copy_n(given.pose->values.begin(), to_world.m.size(), to_world.m.begin());
        sensor_pose.pose = pose_of(to_world);
    }
    if (given.camera || given.lookat) {
        const auto camera = camera_of(request);
        if (!camera) return tl::unexpected(camera.error());
        sensor_pose.pose = pose_of(camera->to_world);
    }
    return sensor_pose;
}

Generated ready(Sensor sensor) {
    const ImageSize grid = ray_grid(sensor);
    return std::make_shared<LateSensor>(grid, [sensor = std::move(sensor)] { return sensor; });
}

Reply<Generated> make_camera(const Request& request) {
    auto camera = camera_of(request);
    if (!camera) return tl::unexpected(camera.error());
    return ready(camera_sensor(*camera, request.sensor_pose, request.size));
}

Reply<Generated> make_pinhole(const Request& request) {
    const GeneratorSettings& given = request.settings;
    const auto number = [](const std::optional<setting::Number>& value, double otherwise) {
        return value ? value->at(0) : otherwise;
    };
    const double fx = number(given.fx, 0), fy = number(given.fy, fx);
    if (!(fx > 0 && fy > 0)) return lacks(request.kind, "fx and fy above 0");
    return ready(Pinhole{request.sensor_pose, request.size,
                         number(given.cx, 0.5 * request.size.width),
                         number(given.cy, 0.5 * request.size.height), 1 / fx, 1 / fy});
}

Reply<Generated> make_orthographic(const Request& request) {
    const auto& window = request.settings.window;
    if (!window || !(window->at(0) > 0 && window->at(1) > 0))
        return lacks(request.kind, "window=WIDTHxHEIGHT, both above 0");
    return ready(Orthographic{request.sensor_pose, request.size, window->at(0), window->at(1)});
}

Reply<Generated> make_equirectangular(const Request& request) {
    return ready(Equirectangular(request.sensor_pose, request.size));
}

/// Converts a camera's pose to a lidar's: the lidar's x (ahead), y, z are the camera's -z, -x, y.
Pose lidar_pose(const Pose& camera) {
    return {-camera.z, -camera.x, camera.y, camera.origin};
}

Reply<Generated> make_lidar(const Request& request) {
    const GeneratorSettings& given = request.settings;
    if (!given.elevations || !given.azimuths) return lacks(request.kind, "elevations and azimuths");
    std::vector<LidarChannel> channels;
    for (const float elevation : given.elevations->values)
        channels.push_back({static_cast<double>(elevation)});
    const auto one_each = [&](const char* name, std::size_t count) -> Reply<void> {
        if (count == channels.size()) return {};
        return refuse(Code::invalid_field, std::string(name) + " must be as many as elevations");
    };
    if (const auto& offsets = given.azimuth_offsets) {
        if (auto good = one_each("azimuth_offsets", offsets->values.size()); !good)
            return tl::unexpected(good.error());
        for (std::size_t i = 0; i < channels.size(); ++i)
            channels[i].azimuth_offset = offsets->at(i);
    }
    if (const auto& offsets = given.origin_offsets) {
        if (auto good = one_each("origin_offsets", offsets->values.size() / 3); !good)
            return tl::unexpected(good.error());
        for (std::size_t i = 0; i < channels.size(); ++i)
            channels[i].origin_offset = offsets->vector(i);
    }
    SensorPose sensor_pose = request.sensor_pose;
    if (given.camera || given.lookat) sensor_pose.pose = lidar_pose(sensor_pose.pose);
    const setting::Sweep sweep = *given.azimuths;
    const ImageSize grid{sweep.count, static_cast<std::uint32_t>(channels.size())};
    return std::make_shared<LateSensor>(grid, [=, channels = std::move(channels)] {
        return Sensor{Lidar(sensor_pose, channels, sweep.start, sweep.stop, sweep.count)};
    });
}

/// Twice what rounding moves a point of the scene: some bits of its farthest coordinate.
float leaving_margin(const Snapshot& scene) {
    const Box& box = scene.bounds();
    if (box.is_empty()) return 0;
    const Vec3 farthest = glm::max(glm::abs(box.lower), glm::abs(box.upper));
    return 0x1p-20F * std::max({farthest.x, farthest.y, farthest.z});
}

Reply<Generated> make_hemisphere(const Request& request) {
    const GeneratorSettings& given = request.settings;
    Hemisphere made{given.samples.value_or(setting::Samples{}).value,
                    given.seed.value_or(setting::Whole{}).value, leaving_margin(request.scene)};
    if (given.margin) made.margin = given.margin->values[0];
    if (!std::isfinite(made.margin) || made.margin < 0)
        return refuse(Code::invalid_field, "margin must be 0 or more");
    return made;
}

struct Kind {
    std::string_view name;
    std::string_view settings;
    Reply<Generated> (*make)(const Request&);
};
constexpr std::array kinds = {
#define RAYNEST_GENERATOR(name, settings, t, rays) Kind{#name, settings, make_##name},
#include "protocol/generators.def"
};

struct Key {
    std::string_view name;
    Reply<void> (*read)(std::string_view text, GeneratorSettings& to);
};
constexpr std::array keys = {
#define RAYNEST_SETTING(name, type, text)                          \
    Key{#name, [](std::string_view given, GeneratorSettings& to) { \
            return setting::read(given, to.name.emplace());        \
        }},
#include "protocol/generators.def"
};

/// True if `word` is one of `names`, a list like "a, b, c".
bool among(std::string_view names, std::string_view word) {
    for (std::size_t at = 0, end = 0; at < names.size(); at = end + 2) {
        end = std::min(names.find(", ", at), names.size());
        if (names.substr(at, end - at) == word) return true;
    }
    return false;
}

Reply<void> read_setting(const Kind& kind, std::string_view word, GeneratorSettings& to) {
    const std::size_t equals = word.find('=');
    const std::string name(word.substr(0, equals));
    const auto* key =
        std::find_if(keys.begin(), keys.end(), [&](const Key& each) { return each.name == name; });
    if (key == keys.end() || !among(kind.settings, name))
        return refuse(Code::invalid_field, name + " is no key of " + std::string(kind.name) +
                                               "; its keys are " + std::string(kind.settings));
    auto read = key->read(word.substr(equals + 1), to);
    if (!read) return refuse(read.error().code, name + ": " + read.error().message);
    return {};
}

}  // namespace

Reply<Generated> generate(const wire::Generator& message, const Snapshot& scene) {
    const std::string_view name = protocol::text(message.kind());
    const auto* kind = std::find_if(kinds.begin(), kinds.end(),
                                    [&](const Kind& each) { return each.name == name; });
    if (kind == kinds.end()) {
        std::string known;
        for (const Kind& each : kinds)
            known += (known.empty() ? "" : ", ") + std::string(each.name);
        return refuse(Code::invalid_field,
                      "there is no generator '" + std::string(name) + "'; there are " + known);
    }
    GeneratorSettings settings;
    std::set<std::string> given;
    for (const std::string& word : protocol::strings(message.settings())) {
        if (auto read = read_setting(*kind, word, settings); !read)
            return tl::unexpected(read.error());
        const std::string key = word.substr(0, word.find('='));
        if (!given.insert(key).second) return refuse(Code::invalid_field, key + " is given twice");
    }
    Request request{name, settings, scene};
    if (settings.size) request.size = settings.size->value;
    auto sensor_pose = sensor_pose_of(request);
    if (!sensor_pose) return tl::unexpected(sensor_pose.error());
    request.sensor_pose = *sensor_pose;
    return kind->make(request);
}

}  // namespace raynest::server
