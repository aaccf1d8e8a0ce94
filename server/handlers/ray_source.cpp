#include "server/handlers/ray_source.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {
namespace {

Vec3 vector(const wire::Vec3* v, const Vec3& otherwise) {
    return v == nullptr ? otherwise : Vec3{v->x(), v->y(), v->z()};
}

constexpr std::uint64_t tile_rows = 8;  // tile_order(), integrators/camera.h

/// A generator's message, with what most kinds make of it.
struct Request {
    const wire::Generator& message;
    const Snapshot& scene;
    Mount mount = {};
    ImageSize size = {};
};

Reply<void> needs(bool holds, const wire::Generator& message, const char* what) {
    if (holds) return {};
    return refuse(Code::invalid_field,
                  "generator " + std::string(protocol::text(message.kind())) + " needs " + what);
}

Reply<Camera> camera_of(const Request& request) {
    auto camera = choose_camera(request.scene, camera_request(request.message.camera()));
    if (!camera) return refuse(Code::invalid_field, camera.error().message);
    return std::move(*camera);
}

Reply<Mount> mount_of(const Request& request) {
    const wire::Generator& m = request.message;
    Mount mount;
    mount.tmin = m.tmin();
    if (m.tmax() != 0) mount.tmax = m.tmax();
    if (auto range = needs(mount.tmin >= 0 && mount.tmin <= mount.tmax, m,
                           "0 <= tmin <= tmax (tmax 0: no end)");
        !range)
        return tl::unexpected(range.error());
    Transform pose;
    if (m.pose() != nullptr && m.pose()->size() == pose.m.size()) {
        std::copy(m.pose()->begin(), m.pose()->end(), pose.m.begin());
        mount.pose = pose_of(pose);
    } else if (m.camera() != nullptr) {
        const auto camera = camera_of(request);
        if (!camera) return tl::unexpected(camera.error());
        mount.pose = pose_of(camera->to_world);
    }
    return mount;
}

SensorPointer ready(Sensor sensor) {
    const ImageSize grid = ray_grid(sensor);
    return std::make_shared<LateSensor>(grid, [sensor = std::move(sensor)] { return sensor; });
}

Reply<SensorPointer> make_camera(const Request& request) {
    auto camera = camera_of(request);
    if (!camera) return tl::unexpected(camera.error());
    return ready(camera_sensor(*camera, request.mount, request.size));
}

Reply<SensorPointer> make_pinhole(const Request& request) {
    const wire::Generator& m = request.message;
    if (auto focal = needs(m.fx() > 0 && m.fy() > 0, m, "fx and fy above 0"); !focal)
        return tl::unexpected(focal.error());
    return ready(Pinhole{request.mount, request.size, static_cast<double>(m.cx()),
                         static_cast<double>(m.cy()), 1 / static_cast<double>(m.fx()),
                         1 / static_cast<double>(m.fy())});
}

Reply<SensorPointer> make_orthographic(const Request& request) {
    const wire::Generator& m = request.message;
    if (auto window = needs(m.window_width() > 0 && m.window_height() > 0, m,
                            "window_width and window_height above 0");
        !window)
        return tl::unexpected(window.error());
    return ready(Orthographic{request.mount, request.size, static_cast<double>(m.window_width()),
                              static_cast<double>(m.window_height())});
}

Reply<SensorPointer> make_equirectangular(const Request& request) {
    return ready(Equirectangular(request.mount, request.size));
}

/// Where a camera looks is ahead of a lidar, whose x is the camera's -z, its y the -x, its z the y.
Pose lidar_pose(const Pose& camera) {
    return {-camera.z, -camera.x, camera.y, camera.origin};
}

Reply<SensorPointer> make_lidar(const Request& request) {
    const wire::Generator& m = request.message;
    const auto size = [](const auto* list) { return list != nullptr ? list->size() : 0U; };
    std::vector<LidarChannel> channels(size(m.elevations()));
    if (auto beams =
            needs(!channels.empty() && m.azimuth_count() != 0, m, "elevations and azimuths");
        !beams)
        return tl::unexpected(beams.error());
    for (std::uint32_t i = 0; i < channels.size(); ++i) {
        channels[i].elevation = static_cast<double>(m.elevations()->Get(i));
        if (size(m.azimuth_offsets()) != 0)
            channels[i].azimuth_offset = static_cast<double>(m.azimuth_offsets()->Get(i));
        if (size(m.origin_offsets()) != 0)
            channels[i].origin_offset = vector(m.origin_offsets()->Get(i), Vec3(0));
    }
    Mount mount = request.mount;
    if (size(m.pose()) == 0 && m.camera() != nullptr) mount.pose = lidar_pose(mount.pose);
    const ImageSize grid{m.azimuth_count(), static_cast<std::uint32_t>(channels.size())};
    return std::make_shared<LateSensor>(
        grid, [=, start = static_cast<double>(m.azimuth_start()),
               stop = static_cast<double>(m.azimuth_stop()), channels = std::move(channels)] {
            return Sensor{Lidar(mount, channels, start, stop, grid.width)};
        });
}

struct Kind {
    std::string_view name;
    bool image;  ///< needs width and height
    Reply<SensorPointer> (*make)(const Request&);
};
/// THE LIST of sensors. What starts from points is no sensor: hemisphere.
constexpr std::array kinds = {
    Kind{"camera", true, make_camera}, Kind{"pinhole", true, make_pinhole},
    Kind{"orthographic", true, make_orthographic},
    Kind{"equirectangular", true, make_equirectangular}, Kind{"lidar", false, make_lidar}};

Reply<SensorPointer> make_sensor(const wire::Generator& message, const Snapshot& scene) {
    const std::string_view name = protocol::text(message.kind());
    const auto* kind = std::find_if(kinds.begin(), kinds.end(),
                                    [&](const Kind& each) { return each.name == name; });
    if (kind == kinds.end()) {
        std::string known;
        for (const Kind& each : kinds) known += std::string(each.name) + ", ";
        return refuse(Code::invalid_field, "unknown generator '" + std::string(name) +
                                               "': use one of " + known + "hemisphere");
    }
    Request request{message, scene, {}, {message.width(), message.height()}};
    if (auto size = needs(!kind->image || request.size.pixels() != 0, message, "width and height");
        !size)
        return tl::unexpected(size.error());
    auto mount = mount_of(request);
    if (!mount) return tl::unexpected(mount.error());
    request.mount = *mount;
    return kind->make(request);
}

constexpr std::uint32_t whole_bytes = sizeof(Ray);
constexpr std::uint32_t rangeless_bytes = 2 * sizeof(Vec3);
constexpr std::uint32_t direction_bytes = sizeof(Vec3);

/// Rays of which `vectors` were sent each, of all else what is common to them.
template <std::size_t vectors>
void widen(const Vec3* sent, const Ray& common, std::span<Ray> rays) {
    for (Ray& out : rays) {
        // Member by member: a whole Ray is made on the stack first, which takes a third more.
        out.origin = vectors == 2 ? sent[0] : common.origin;
        out.tmin = common.tmin;
        out.direction = sent[vectors - 1];
        out.tmax = common.tmax;
        sent += vectors;
    }
}

}  // namespace

Reply<SentRays> SentRays::of(const protocol::Opened<wire::QueryRays>& message) {
    const auto block = protocol::only_block(message.blocks, "rays", wire::Dtype::f32,
                                            {whole_bytes, rangeless_bytes, direction_bytes});
    if (!block) return tl::unexpected(block.error());
    const wire::Vec3* origin = message->origin();
    const bool range = message->tmin() != 0 || message->tmax() != 0;
    if (block->stride == direction_bytes && origin == nullptr)
        return refuse(Code::invalid_field,
                      "rays of 12 bytes are directions: their frame needs an origin");
    if (block->stride != direction_bytes && origin != nullptr)
        return refuse(Code::invalid_field,
                      "the frame has an origin, and so does each of its rays: send directions "
                      "alone, of 12 bytes");
    if (block->stride == whole_bytes && range)
        return refuse(Code::invalid_field,
                      "the frame has tmin and tmax, and so does each of its rays: send them "
                      "without, of 24 or 12 bytes");
    SentRays sent;
    sent.bytes_ = block->bytes;
    sent.stride_ = block->stride;
    sent.common_.origin = vector(origin, sent.common_.origin);
    sent.common_.tmin = message->tmin();
    if (message->tmax() != 0) sent.common_.tmax = message->tmax();
    return sent;
}

std::span<const Ray> SentRays::rays(std::uint64_t first, std::uint64_t count,
                                    std::vector<Ray>& room) const {
    const std::byte* sent = bytes_.data() + first * stride_;
    if (stride_ == whole_bytes) return {reinterpret_cast<const Ray*>(sent), count};
    room.resize(count);
    const auto* vectors = reinterpret_cast<const Vec3*>(sent);
    stride_ == direction_bytes ? widen<1>(vectors, common_, room)
                               : widen<2>(vectors, common_, room);
    return room;
}

CameraRequest camera_request(const wire::Camera* camera) {
    CameraRequest request;
    if (camera == nullptr) return request;
    request.name = protocol::text(camera->name());
    request.look_at = camera->look_at();
    request.eye = vector(camera->eye(), request.eye);
    request.at = vector(camera->at(), request.at);
    request.up = vector(camera->up(), request.up);
    request.fov_degrees = camera->fov_degrees();
    return request;
}

Reply<RaySource> RaySource::make(const wire::Query& query, const Snapshot& scene) {
    RaySource source;
    source.rays_ = query.ray_count();
    const wire::Generator* generator = query.generator();
    if (generator == nullptr) return source;
    if (protocol::text(generator->kind()) == "hemisphere") {
        source.origin_ = Hemisphere{generator->samples(), generator->seed()};
        source.rays_ *= generator->samples();
        return source;
    }
    auto sensor = make_sensor(*generator, scene);
    if (!sensor) return tl::unexpected(sensor.error());
    source.rays_ = (*sensor)->grid().pixels();
    source.origin_ = std::move(*sensor);
    return source;
}

std::uint64_t RaySource::rays_per_point() const {
    const auto* hemisphere = std::get_if<Hemisphere>(&origin_);
    return hemisphere != nullptr ? hemisphere->samples : 1;
}

std::uint64_t RaySource::chunk_rays(std::uint64_t most) const {
    const auto* sensor = std::get_if<SensorPointer>(&origin_);
    const std::uint64_t band = sensor != nullptr ? tile_rows * (*sensor)->grid().width : 0;
    return band == 0 || band > most ? most : most / band * band;
}

std::span<const Ray> RaySource::rays_of(const Piece& piece, TraceBuffers& buffers) const {
    if (std::holds_alternative<Sent>(origin_)) {
        if (piece.more.empty())
            return piece.sent.rays(piece.first - piece.sent_first, piece.count, buffers.sent);
        buffers.rays.clear();
        for (const Piece& part : piece.parts()) {
            const auto rays =
                part.sent.rays(part.first - part.sent_first, part.count, buffers.sent);
            buffers.rays.insert(buffers.rays.end(), rays.begin(), rays.end());
        }
        return buffers.rays;
    }
    buffers.rays.resize(piece.count);
    if (const auto* sensor = std::get_if<SensorPointer>(&origin_)) {
        generate_rays((*sensor)->get(), piece.first, buffers.rays);
    } else {
        const Hemisphere& hemisphere = std::get<Hemisphere>(origin_);
        const std::uint64_t first = piece.first / hemisphere.samples;
        const std::uint64_t last = (piece.first + piece.count - 1) / hemisphere.samples;
        const auto points =
            piece.sent.rays(first - piece.sent_first, last - first + 1, buffers.sent);
        generate_rays(hemisphere, points, first, piece.first, buffers.rays);
    }
    return buffers.rays;
}

void RaySource::generate(const Piece& piece, bool tiles, std::span<Ray> rays) const {
    const Sensor& sensor = std::get<SensorPointer>(origin_)->get();
    tiles ? generate_tiles(sensor, piece.first, rays) : generate_rays(sensor, piece.first, rays);
}

std::optional<PinholeRays> RaySource::made(const Piece& piece, bool tiles) const {
    const auto* sensor = std::get_if<SensorPointer>(&origin_);
    const auto* camera = sensor != nullptr ? std::get_if<Pinhole>(&(*sensor)->get()) : nullptr;
    if (camera == nullptr) return std::nullopt;
    return PinholeRays{*camera, piece.first, tiles};
}

bool RaySource::has_tiles(const Piece& piece) const {
    const auto* sensor = std::get_if<SensorPointer>(&origin_);
    const std::uint64_t band = sensor != nullptr ? tile_rows * (*sensor)->grid().width : 0;
    const bool to_the_end = piece.first + piece.count == rays_;
    return band != 0 && piece.first % band == 0 && (piece.count % band == 0 || to_the_end);
}

Reply<std::span<const Ray>> RaySource::trace(const Plan& plan, const Piece& piece, const Stop& stop,
                                             TraceBuffers& buffers, bool any_order) const {
    const bool tiles = any_order && has_tiles(piece);
    const auto camera = plan.on_cuda(piece.fallback) ? made(piece, tiles) : std::nullopt;
    std::span<const Ray> rays;
    if (tiles || camera) {
        buffers.rays.resize(piece.count);
        rays = buffers.rays;
        if (!camera) generate(piece, tiles, buffers.rays);
    } else {
        rays = rays_of(piece, buffers);
    }
    if (auto traced = server::trace(plan, rays, stop, buffers, camera ? &*camera : nullptr);
        !traced)
        return tl::unexpected(traced.error());
    if (camera && plan.reads_rays) generate(piece, tiles, buffers.rays);
    if (tiles) {
        const ImageSize size = std::get<SensorPointer>(origin_)->grid();
        buffers.order.resize(piece.count);
        for_each_in_tiles(piece.first, piece.count, size.width, size.height,
                          [&](std::uint64_t i, std::uint64_t x, std::uint64_t y) {
                              buffers.order[y * size.width + x - piece.first] =
                                  static_cast<std::uint32_t>(i);
                          });
    }
    return rays;
}

}  // namespace raynest::server
