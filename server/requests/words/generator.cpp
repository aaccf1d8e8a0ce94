#include "server/requests/words/generator.h"

#include "protocol/control.h"
#include "protocol/text.h"
#include "server/requests/words/setting_types.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {
namespace {

Vec3 vector(const wire::Vec3* v, const Vec3& otherwise) {
    return v == nullptr ? otherwise : Vec3{v->x(), v->y(), v->z()};
}

struct GeneratorSettings {
#define RAYNEST_SETTING(name, type, text) std::optional<setting::type> name;
#include "protocol/lists/generators.def"
};

/// The settings of a generator, and the values that most kinds derive from them.
struct Wanted {
    std::string_view kind;
    const GeneratorSettings& settings;
    const Snapshot& scene;
    SensorPose sensor_pose = {};
    ImageSize size = {960, 540};
};

tl::unexpected<protocol::Error> lacks(std::string_view kind, const char* what) {
    return refuse(Code::invalid_field, "generator " + std::string(kind) + " needs " + what);
}

/// The way up of a look-at: its own, or the scene's.
glm::dvec3 up_of(const Wanted& request) {
    const auto& look_at = request.settings.lookat;
    return look_at && look_at->values.size() == 9 ? look_at->vector(2)
                                                  : upwards(request.scene.up());
}

Reply<Camera> camera_of(const Wanted& request) {
    const GeneratorSettings& given = request.settings;
    if (given.camera && request.scene.statistics().cameras.empty())
        return refuse(Code::invalid_field,
                      "the scene has no cameras: give the sensor a pose or a look-at instead");
    CameraRequest wanted;
    if (given.camera) wanted.name = given.camera->value;
    if (given.fov) wanted.fov_degrees = given.fov->value;
    if (const auto& look_at = given.lookat) {
        wanted.look_at = true;
        wanted.eye = Vec3(look_at->vector(0));
        wanted.at = Vec3(look_at->vector(1));
        wanted.up = Vec3(up_of(request));
    }
    auto camera = choose_camera(request.scene, wanted);
    if (!camera) return refuse(Code::invalid_field, camera.error().message);
    return std::move(*camera);
}

/// Reads a pose, which may turn and move a sensor. One that scales would change what t measures,
/// one that mirrors the way that a head turns. Axes of three digits pass.
Reply<Pose> rigid_pose(const setting::Matrix& given) {
    constexpr double tolerance = 2e-3;
    const auto column = [&](std::size_t i) {
        return glm::dvec3(given.at(i), given.at(4 + i), given.at(8 + i));
    };
    const Pose pose{column(0), column(1), column(2), column(3)};
    const auto off = [](double value, double wanted) {
        return !(std::abs(value - wanted) <= tolerance);
    };
    const glm::dvec3 lengths(glm::length(pose.x), glm::length(pose.y), glm::length(pose.z));
    if (off(lengths.x, 1) || off(lengths.y, 1) || off(lengths.z, 1)) {
        std::ostringstream message;
        message.precision(3);
        message << "pose: it scales, its axes have the lengths " << lengths.x << ", " << lengths.y
                << " and " << lengths.z << ": a sensor is turned and moved only";
        return refuse(Code::invalid_field, message.str());
    }
    if (off(glm::dot(pose.x, pose.y), 0) || off(glm::dot(pose.y, pose.z), 0) ||
        off(glm::dot(pose.z, pose.x), 0))
        return refuse(Code::invalid_field,
                      "pose: its axes are not at right angles: a sensor is turned and moved only");
    if (glm::dot(glm::cross(pose.x, pose.y), pose.z) < 0)
        return refuse(
            Code::invalid_field,
            "pose: it mirrors, its axes are left-handed: a sensor is turned and moved only");
    return pose;
}

Reply<SensorPose> sensor_pose_of(const Wanted& request) {
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
        const auto pose = rigid_pose(*given.pose);
        if (!pose) return tl::unexpected(pose.error());
        sensor_pose.pose = *pose;
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

Reply<Generated> make_camera(const Wanted& request) {
    auto camera = camera_of(request);
    if (!camera) return tl::unexpected(camera.error());
    return ready(camera_sensor(*camera, request.sensor_pose, request.size));
}

double number(const std::optional<setting::Number>& given, double otherwise) {
    return given ? given->at(0) : otherwise;
}

Reply<Pinhole> pinhole_of(const Wanted& request) {
    const GeneratorSettings& given = request.settings;
    const double fx = number(given.fx, 0), fy = number(given.fy, fx);
    if (!(fx > 0 && fy > 0)) return lacks(request.kind, "fx and fy above 0");
    return Pinhole{request.sensor_pose,
                   request.size,
                   number(given.cx, 0.5 * request.size.width),
                   number(given.cy, 0.5 * request.size.height),
                   1 / fx,
                   1 / fy};
}

Reply<Generated> make_pinhole(const Wanted& request) {
    auto made = pinhole_of(request);
    if (!made) return tl::unexpected(made.error());
    return ready(std::move(*made));
}

Reply<Generated> make_orthographic(const Wanted& request) {
    const auto& window = request.settings.window;
    if (!window || !(window->at(0) > 0 && window->at(1) > 0))
        return lacks(request.kind, "window=WIDTHxHEIGHT, both above 0");
    return ready(Orthographic{request.sensor_pose, request.size, window->at(0), window->at(1)});
}

Reply<Generated> make_equirectangular(const Wanted& request) {
    return ready(Equirectangular(request.sensor_pose, request.size));
}

/// Returns the pose of a lidar that stands upright where a camera does: z is up, and x, its ahead,
/// the level part of the camera's view; of a camera that looks straight down or up, what is up or
/// down in its picture.
Pose upright(const Pose& camera, const glm::dvec3& up) {
    constexpr double level_min = 1e-6;
    const glm::dvec3 z = glm::normalize(up);
    const auto level = [&](const glm::dvec3& way) { return way - glm::dot(way, z) * z; };
    const glm::dvec3 view = -glm::normalize(camera.z);
    glm::dvec3 ahead = level(view);
    if (glm::length(ahead) < level_min)
        ahead = glm::dot(view, z) < 0 ? level(camera.y) : -level(camera.y);
    const glm::dvec3 x = glm::normalize(ahead);
    return {x, glm::cross(z, x), z, camera.origin};
}

/// Sets what tells channels apart beside their elevations.
Reply<void> read_offsets(const GeneratorSettings& given, std::vector<LidarChannel>& channels) {
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
    return {};
}

Reply<std::vector<LidarChannel>> channels_of(const setting::Steps& elevations) {
    std::vector<LidarChannel> channels;
    for (const double elevation : elevations.values) channels.push_back({elevation});
    if (auto good = check_elevations(channels); !good) return tl::unexpected(good.error());
    return channels;
}

Reply<Generated> make_lidar(const Wanted& request) {
    const GeneratorSettings& given = request.settings;
    if (!given.elevations || !given.azimuths) return lacks(request.kind, "elevations and azimuths");
    auto channels = channels_of(*given.elevations);
    if (!channels) return tl::unexpected(channels.error());
    if (auto good = read_offsets(given, *channels); !good) return tl::unexpected(good.error());
    SensorPose sensor_pose = request.sensor_pose;
    if (given.camera || given.lookat) sensor_pose.pose = upright(sensor_pose.pose, up_of(request));
    const setting::Sweep sweep = *given.azimuths;
    const ImageSize grid{sweep.count, static_cast<std::uint32_t>(channels->size())};
    return std::make_shared<LateSensor>(grid, [=, channels = std::move(*channels)] {
        return Sensor{Lidar(sensor_pose, channels, sweep.start, sweep.stop, sweep.count)};
    });
}

/// Returns a count that a setting gives, or `otherwise`. Fails with LIMIT_EXCEEDED above `most`.
Reply<std::uint32_t> count_of(const char* name, const std::optional<setting::Whole>& given,
                              std::uint32_t otherwise, std::uint64_t most) {
    const std::uint64_t count = given ? given->value : otherwise;
    if (count > most)
        return refuse(Code::limit_exceeded, std::string(name) + ": " + std::to_string(count) +
                                                ", the limit is " + std::to_string(most));
    return static_cast<std::uint32_t>(count);
}

/// Returns what all sensors in motion have: their poses, and the times of a scan.
Reply<SweepOrder> order_of(const Wanted& request) {
    const GeneratorSettings& given = request.settings;
    SweepOrder order;
    order.limits = request.sensor_pose;
    const auto poses = count_of("poses", given.poses, 0, protocol::Limits{}.trajectory_poses_max);
    if (!poses) return tl::unexpected(poses.error());
    if (*poses == 0) return lacks(request.kind, "poses above 0");
    order.poses = *poses;
    order.begin = number(given.begin, 0);
    order.end = number(given.end, 0.1);
    if (!(order.begin <= order.end))
        return refuse(Code::invalid_field, "end: a scan must end after it begins");
    if (given.step_error) {
        order.step_error = given.step_error->at(0);
        if (!(*order.step_error > 0))
            return refuse(Code::invalid_field, "step_error: it must be above 0");
    }
    return order;
}

Reply<Generated> make_sweep(const Wanted& request) {
    const GeneratorSettings& given = request.settings;
    const protocol::Limits limits;
    auto made = order_of(request);
    if (!made) return tl::unexpected(made.error());
    SweepOrder& order = *made;
    const auto channels = count_of("channels", given.channels, 0, limits.sweep_channels_max);
    const auto columns = count_of("columns", given.columns, 0, limits.azimuths_max);
    const auto scans = count_of("scans", given.scans, 1, limits.sweep_columns_max);
    for (const auto* count : {&channels, &columns, &scans})
        if (!*count) return tl::unexpected(count->error());
    order.columns = *columns, order.scans = *scans;
    if (order.scans == 0) return lacks(request.kind, "scans above 0");
    if ((*channels != 0) == given.elevations.has_value() ||
        (order.columns != 0) == given.azimuths.has_value())
        return lacks(request.kind,
                     "elevations or channels, and azimuths or columns: one of each two");
    order.sends_elevations = !given.elevations;
    order.channels.resize(*channels);
    if (given.elevations) {
        auto listed = channels_of(*given.elevations);
        if (!listed) return tl::unexpected(listed.error());
        order.channels = std::move(*listed);
    }
    if (auto good = read_offsets(given, order.channels); !good) return tl::unexpected(good.error());
    if (const auto& sweep = given.azimuths) {
        order.turn.emplace(sweep->start, sweep->stop);
        order.columns = sweep->count;
    }
    if (order.all_lines() > limits.sweep_columns_max ||
        std::uint64_t{order.channels.size()} * order.scans >
            std::numeric_limits<std::uint32_t>::max())
        return refuse(Code::limit_exceeded,
                      "scans: " + std::to_string(order.scans) + " of " +
                          std::to_string(order.columns) +
                          " columns, the limit of all is sweep_columns_max = " +
                          std::to_string(limits.sweep_columns_max) + "; ask for fewer at a time");
    return std::make_shared<LateSensor>(std::make_shared<SentSweep>(std::move(order)));
}

Reply<Generated> make_rolling_shutter(const Wanted& request) {
    auto order = order_of(request);
    if (!order) return tl::unexpected(order.error());
    auto camera = pinhole_of(request);
    if (!camera) return tl::unexpected(camera.error());
    order->camera = *camera;
    return std::make_shared<LateSensor>(std::make_shared<SentSweep>(std::move(*order)));
}

/// A millionth of the scene's size, which is the diagonal of its box.
double leaving_margin(const Snapshot& scene) {
    const Box& box = scene.bounds();
    if (box.is_empty()) return 0;
    return 0x1p-20 * glm::length(glm::dvec3(box.upper) - glm::dvec3(box.lower));
}

Reply<Generated> make_hemisphere(const Wanted& request) {
    const GeneratorSettings& given = request.settings;
    Hemisphere made{given.samples.value_or(setting::Samples{}).value,
                    given.seed.value_or(setting::Whole{}).value, leaving_margin(request.scene),
                    !given.margin};
    if (given.margin) made.margin = given.margin->at(0);
    if (made.margin < 0) return refuse(Code::invalid_field, "margin must be 0 or more");
    return made;
}

struct Kind {
    std::string_view name;
    std::string_view settings;
    Reply<Generated> (*make)(const Wanted&);
};
constexpr std::array kinds = {
#define RAYNEST_GENERATOR(name, settings, t, rays) Kind{#name, settings, make_##name},
#include "protocol/lists/generators.def"
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
#include "protocol/lists/generators.def"
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
    Wanted request{name, settings, scene};
    if (settings.size) request.size = settings.size->value;
    auto sensor_pose = sensor_pose_of(request);
    if (!sensor_pose) return tl::unexpected(sensor_pose.error());
    request.sensor_pose = *sensor_pose;
    return kind->make(request);
}

CameraRequest camera_request(const wire::Camera* camera) {
    CameraRequest request;
    if (camera == nullptr) return request;
    request.name = protocol::text(camera->name());
    request.look_at = camera->look_at();
    request.eye = vector(camera->eye(), request.eye);
    request.at = vector(camera->at(), request.at);
    if (camera->up() != nullptr) request.up = vector(camera->up(), {});
    request.fov_degrees = camera->fov_degrees();
    return request;
}

bool moves_scene(const wire::Generator* generator) {
    if (generator == nullptr) return false;
    return std::ranges::any_of(protocol::strings(generator->settings()), [](const auto& setting) {
        return setting.starts_with("step_error=");
    });
}

Reply<RaySource> read_rays(const wire::Query& query, const Snapshot& scene) {
    const std::uint64_t sent = query.ray_count();
    const wire::Generator* generator = query.generator();
    if (generator == nullptr) return RaySource(sent);
    auto generated = generate(*generator, scene);
    if (!generated) return tl::unexpected(generated.error());
    if (const auto* hemisphere = std::get_if<Hemisphere>(&*generated)) {
        if (sent == 0)
            return refuse(
                Code::invalid_field,
                "generator " + std::string(protocol::text(generator->kind())) + " needs points");
        if (query.part_count() != 0 && query.part_count() != sent)
            return refuse(Code::invalid_field,
                          "part_count: the part is " + std::to_string(query.part_count()) +
                              " points, but ray_count is " + std::to_string(sent) +
                              ": send the points of the part alone");
        return RaySource(*hemisphere, query.part_first(), sent);
    }
    if (sent != 0)
        return refuse(Code::invalid_field, "ray_count must be 0 where the daemon makes the rays");
    auto sensor = std::get<SensorPointer>(std::move(*generated));
    const std::uint64_t all = sensor->grid().pixels();
    const std::uint64_t first = query.part_first();
    if (all != 0 && (first >= all || query.part_count() > all - first))
        return refuse(Code::invalid_field, "part: rays " + std::to_string(first) + " to " +
                                               std::to_string(first + query.part_count()) +
                                               ", but the generator makes " + std::to_string(all));
    return RaySource(std::move(sensor), first,
                     query.part_count() != 0 ? query.part_count() : all - first);
}

}  // namespace raynest::server
