// raynest-bench-service: what it costs to ask a daemon instead of tracing in process.
//
//   service.py BIN_DIR                    starts a daemon for it, and says what the rows mean
//
// Sides take turns, one lap after the other in one process, on the same rays and with one thread
// that traces. CPU time is that of this process and the daemon's, all threads of both.
#include "client/net/connection.h"
#include "client/requests/query.h"
#include "engine/integrators/generators.h"
#include "engine/packs/kernel_selector.h"
#include "tests/bench/clock.h"
#include "tests/bench/cpus.h"
#include "tests/bench/crowding.h"
#include "tests/bench/load_test/echo.h"
#include "tests/bench/race.h"
#include "tests/bench/rays.h"
#include "tests/bench/workload.h"

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <sys/socket.h>

#include <algorithm>
#include <functional>
#include <iostream>
#include <limits>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace raynest::bench {
namespace {

struct Options {
    std::string server;
    int daemon_pid = 0;
    std::string scene = "gen:terrain";
    std::string name;  ///< the scene's at the daemon
    std::string rays = "diffuse";
    std::uint32_t count = 1 << 20;
    int rounds = 9;
    std::vector<std::string> sides;  ///< that run, for a profiler; empty: all
};

/// The cost of answering all rays once.
struct Cost {
    double cpu_seconds;
    double wall_seconds;
    double crowding;  ///< any CPU's, before it or after it
};

/// The columns that all sides fill.
struct Answer {
    std::vector<float> t;
    std::vector<std::uint32_t> prim;
    explicit Answer(std::size_t rays) : t(rays), prim(rays) {}
    bool operator==(const Answer&) const = default;
};

struct Side {
    std::string name;
    std::function<void(Answer&)> run;
    std::vector<Cost> laps = {};
};

[[noreturn]] void give_up(const std::string& why) {
    std::cerr << "raynest-bench-service: " << why << "\n";
    std::exit(1);
}

template <class T, class E>
T must(tl::expected<T, E>&& result) {
    if (!result) give_up(result.error().message);
    if constexpr (!std::is_void_v<T>) return std::move(*result);
}

/// The most of all CPUs: client, io thread and worker share them.
double crowding_anywhere() {
    std::vector<double> of(cpu_count());
    {
        std::vector<std::jthread> threads;
        for (unsigned cpu = 0; cpu < of.size(); ++cpu)
            threads.emplace_back([&of, cpu] {
                pin(cpu);
                of[cpu] = crowding();
            });
    }
    return *std::max_element(of.begin(), of.end());
}

Cost time(const Options& options, const std::function<void()>& work) {
    clockid_t daemon{};
    if (clock_getcpuclockid(options.daemon_pid, &daemon) != 0) give_up("the daemon is gone");
    const auto cpu = [&] { return seconds_of(CLOCK_PROCESS_CPUTIME_ID) + seconds_of(daemon); };
    const double crowding_before = crowding_anywhere();
    const double cpu_before = cpu();
    const double wall_before = seconds_of(CLOCK_MONOTONIC);
    work();
    const double wall = seconds_of(CLOCK_MONOTONIC) - wall_before;
    const double cpu_seconds = cpu() - cpu_before;
    return {cpu_seconds, wall, std::max(crowding_before, crowding_anywhere())};
}

// ---- in process ---------------------------------------------------------------------

constexpr std::uint32_t chunk_rays = 16384;

/// As a program does that links the engine: chunk by chunk, records into columns.
class InProcess {
public:
    InProcess(const Workload& workload, const Variant& variant)
        : scene_(workload.scene->view()),
          selector_(must(KernelSelector::make(variant, query_closest, traversal_auto))),
          hits_(chunk_rays) {}

    void trace(std::span<const Ray> rays, std::uint64_t first, Answer& answer) {
        TraceCall call{};
        call.scene = &scene_;
        call.rays = rays.data();
        call.ray_count = static_cast<std::uint32_t>(rays.size());
        call.hits_max = 1;
        call.mask = ~std::uint32_t{0};
        call.hits = hits_.data();
        selector_.function(selector_.choose(rays, scene_))(&call);
        for (std::size_t i = 0; i < rays.size(); ++i) {
            const HitRecord& hit = hits_[i];
            const ObjectRecord& object = scene_.objects[hit.hit != 0 ? hit.object : 0];
            answer.t[first + i] = hit.hit != 0 ? hit.t : std::numeric_limits<float>::infinity();
            answer.prim[first + i] =
                hit.hit == 0
                    ? no_id
                    : hit.triangle - scene_.geometry_of(object, hit.triangle).first_triangle;
        }
    }

private:
    const SceneView scene_;
    const KernelSelector selector_;
    std::vector<HitRecord> hits_;
};

template <class Work>
void for_each_chunk(std::uint64_t count, Work work) {
    for (std::uint64_t first = 0; first < count; first += chunk_rays)
        work(first, std::min<std::uint64_t>(chunk_rays, count - first));
}

// ---- by the daemon ------------------------------------------------------------------

void ask(client::Connection& connection, const wire::QueryT& request, const client::RaySource& rays,
         Answer& answer) {
    client::Progress silent(client::Progress::Style::none);
    const auto take = [&](const client::QueryChunk& chunk) -> client::Result<void> {
        for (const protocol::BlockView& column : chunk.columns) {
            std::byte* out = column.name == "t" ? reinterpret_cast<std::byte*>(answer.t.data())
                                                : reinterpret_cast<std::byte*>(answer.prim.data());
            std::copy(column.bytes.begin(), column.bytes.end(), out + 4 * chunk.first_ray);
        }
        return {};
    };
    must(client::run_query(connection, request, rays, silent, take));
}

wire::QueryT request_of(const Options& options, const std::string& kind, std::uint64_t count) {
    wire::QueryT request;
    request.job = std::make_unique<wire::JobT>();
    request.job->scene = options.name;
    request.job->intersector = "opaque";
    request.kind = kind;
    request.fields = {"t", "prim"};
    request.ray_count = count;
    return request;
}

// ---- controls -----------------------------------------------------------------------

/// The rays there and as many bytes as their columns back, chunk by chunk, and nothing else: from
/// and to the whole arrays, which no cache holds.
class BareSockets {
public:
    BareSockets(int like, const client::RaySource& rays)
        : rays_(rays.bytes(0, rays.count())),
          request_bytes_(chunk_rays * rays.ray_bytes()),
          columns_(rays.count() * row_bytes) {
        pairs_ = must(client::connect_pairs(like, 1));
        echo_ = client::echo_by_threads(std::move(pairs_.far),
                                        {request_bytes_, std::vector<std::byte>(reply_bytes)});
    }
    void run() {
        const int socket = pairs_.near.front().number();
        std::jthread sender([&] {
            for (std::size_t sent = 0; sent < rays_.size();) {
                const std::size_t rest_of_chunk = request_bytes_ - sent % request_bytes_;
                const auto part = ::send(socket, &rays_[sent], rest_of_chunk, MSG_NOSIGNAL);
                if (part <= 0) give_up("the control's socket closed");
                sent += static_cast<std::size_t>(part);
            }
        });
        for (std::size_t got = 0; got < columns_.size(); got += reply_bytes)
            if (::recv(socket, &columns_[got], reply_bytes, MSG_WAITALL) !=
                static_cast<ssize_t>(reply_bytes))
                give_up("the control's socket closed");
    }

private:
    static constexpr std::size_t row_bytes = sizeof(float) + sizeof(std::uint32_t);
    static constexpr std::size_t reply_bytes = chunk_rays * row_bytes;
    const std::span<const std::byte> rays_;
    const std::size_t request_bytes_;
    std::vector<std::byte> columns_;
    client::SocketPairs pairs_;
    std::unique_ptr<client::Echo> echo_;
};

// ---- the race -----------------------------------------------------------------------

Lidar lidar_of(const Workload& workload, std::span<const LidarChannel> channels,
               std::uint32_t azimuths) {
    const Pose camera = pose_of(must(choose_camera(*workload.scene, {})).to_world);
    SensorPose sensor_pose;
    // Upright, ahead where the camera looks, as the daemon stands it.
    const glm::dvec3 up(0, 1, 0);
    const glm::dvec3 view = -glm::normalize(camera.z);
    const glm::dvec3 ahead = glm::normalize(view - glm::dot(view, up) * up);
    sensor_pose.pose = {ahead, glm::cross(up, ahead), up, camera.origin};
    return {sensor_pose, channels, 0, 360, azimuths};
}

/// A tenth more than where all CPUs were ours. The least may be an outlier.
double crowded_from(const std::vector<Side>& sides) {
    std::vector<double> crowdings;
    for (const Side& side : sides)
        for (const Cost& lap : side.laps) crowdings.push_back(lap.crowding);
    const auto low = crowdings.begin() + static_cast<std::ptrdiff_t>(crowdings.size() / 20);
    std::nth_element(crowdings.begin(), low, crowdings.end());
    return 1.1 * *low;
}

/// Laps in which nobody else was on a core, as far as can be told; all where there are none.
std::vector<Cost> uncrowded(const Side& side, double crowded_from) {
    std::vector<Cost> laps;
    for (const Cost& lap : side.laps)
        if (lap.crowding < crowded_from) laps.push_back(lap);
    return laps.empty() ? side.laps : laps;
}

double median_of(const std::vector<Cost>& laps, double Cost::*value) {
    std::vector<double> values;
    for (const Cost& lap : laps) values.push_back(lap.*value);
    return median(std::move(values));
}

void print(const Options& options, const Side& side, const Side* against, double crowded_from) {
    const std::vector<Cost> laps = uncrowded(side, crowded_from);
    const double cpu = median_of(laps, &Cost::cpu_seconds);
    const double wall = median_of(laps, &Cost::wall_seconds);
    nlohmann::ordered_json row;
    row["scene"] = options.name;
    row["rays"] = options.rays;
    row["side"] = side.name;
    const double count = options.count;
    row["cpu_ns_per_ray"] = 1e9 * cpu / count;
    row["wall_ns_per_ray"] = 1e9 * wall / count;
    row["against"] = against == nullptr ? "" : against->name;
    if (against != nullptr) {
        const std::vector<Cost> others = uncrowded(*against, crowded_from);
        row["cpu_ratio"] = cpu / median_of(others, &Cost::cpu_seconds);
        row["wall_ratio"] = wall / median_of(others, &Cost::wall_seconds);
    }
    row["cpu_ns_per_ray_all"] = 1e9 * median_of(side.laps, &Cost::cpu_seconds) / count;
    row["crowded_from"] = crowded_from;
    row["uncrowded"] = std::ranges::count_if(
        side.laps, [&](const Cost& lap) { return lap.crowding < crowded_from; });
    row["count"] = options.count;
    row["rounds"] = side.laps.size();
    std::cout << row.dump() << std::endl;
}

/// Whom a side is compared with; empty: nobody.
std::string opponent_of(const std::string& side) {
    if (side.starts_with("null")) return "sockets" + side.substr(std::string("null").size());
    if (side.starts_with("service"))
        return "in_process" + side.substr(std::string("service").size());
    return "";
}

/// Has some side fewer uncrowded laps than a median needs?
bool too_crowded(const std::vector<Side>& sides, int rounds) {
    const double limit = crowded_from(sides);
    const auto enough = std::min<std::ptrdiff_t>(5, rounds);
    return std::ranges::any_of(sides, [&](const Side& side) {
        return std::ranges::count_if(
                   side.laps, [&](const Cost& lap) { return lap.crowding < limit; }) < enough;
    });
}

void race_sides(const Options& options, std::vector<Side>& sides) {
    Answer answer(options.count);
    for (Side& side : sides) side.run(answer);  // warms caches and pages
    const int rounds = options.rounds;
    for (int round = 0; round < rounds || (round < 3 * rounds && too_crowded(sides, rounds));
         ++round)
        for (std::size_t i = 0; i < sides.size(); ++i) {
            Side& side = sides[(i + static_cast<std::size_t>(round)) % sides.size()];
            side.laps.push_back(time(options, [&] { side.run(answer); }));
        }
}

/// Both must answer alike, else nothing is timed.
void check_alike(const Side& a, const Side& b, std::uint32_t count) {
    Answer of_a(count);
    Answer of_b(count);
    a.run(of_a);
    b.run(of_b);
    if (of_a != of_b) give_up(a.name + " and " + b.name + " differ");
}

void run(Options options) {
    const auto registry = must(Registry::load({}));
    const Workload workload = must(load_workload(options.scene, *registry));
    const Variant& variant = *must(registry->choose("opaque", workload.scene->view()));
    InProcess in_process(workload, variant);
    const auto connection = must(client::Connection::open(options.server, ""));

    const RayKind kind = must(parse_ray_kind(options.rays));
    const TraceFunction trace = must(find_function(variant, query_closest, traversal_single));
    std::vector<Ray> rays = make_rays(workload, kind, options.count, trace);
    options.count = static_cast<std::uint32_t>(rays.size()) / chunk_rays * chunk_rays;
    rays.resize(options.count);
    std::vector<float> values;
    std::vector<float> short_values;  // without the ranges
    std::vector<float> directions;
    for (const Ray& ray : rays) {
        const auto& o = ray.origin;
        const auto& d = ray.direction;
        values.insert(values.end(), {o.x, o.y, o.z, ray.tmin, d.x, d.y, d.z, ray.tmax});
        short_values.insert(short_values.end(), {o.x, o.y, o.z, d.x, d.y, d.z});
        directions.insert(directions.end(), {d.x, d.y, d.z});
    }
    const client::RaySource sent(std::move(values), 8);
    const client::RaySource sent_short(std::move(short_values), 6);
    const client::RaySource sent_fan(std::move(directions), 3, wire::Vec3(0, 0, 0));
    const client::RaySource none(std::vector<client::WorldRay>{});

    constexpr std::uint32_t channel_count = 64;
    std::vector<LidarChannel> channels(channel_count);
    wire::QueryT generated = request_of(options, "closest", 0);
    generated.generator = std::make_unique<wire::GeneratorT>();
    generated.generator->kind = "lidar";
    const auto azimuths = static_cast<std::uint32_t>(options.count / channel_count);
    for (std::uint32_t i = 0; i < channel_count; ++i) channels[i].elevation = -30 + 0.75 * i;
    generated.generator->settings = {"camera=", "elevations=-30:17.25:64",
                                     "azimuths=0:360:" + std::to_string(azimuths)};
    const Lidar lidar = lidar_of(workload, channels, azimuths);

    BareSockets sockets(connection->socket(), sent);
    BareSockets sockets_short(connection->socket(), sent_short);
    BareSockets sockets_fan(connection->socket(), sent_fan);
    const wire::QueryT null = request_of(options, "null", options.count);
    const wire::QueryT closest = request_of(options, "closest", options.count);
    std::vector<Ray> made(chunk_rays);
    std::vector<Side> sides;
    sides.push_back({"sockets", [&](Answer&) { sockets.run(); }});
    sides.push_back({"null", [&](Answer& answer) { ask(*connection, null, sent, answer); }});
    sides.push_back({"sockets_short", [&](Answer&) { sockets_short.run(); }});
    sides.push_back(
        {"null_short", [&](Answer& answer) { ask(*connection, null, sent_short, answer); }});
    sides.push_back({"sockets_fan", [&](Answer&) { sockets_fan.run(); }});
    sides.push_back(
        {"null_fan", [&](Answer& answer) { ask(*connection, null, sent_fan, answer); }});
    sides.push_back({"in_process", [&](Answer& answer) {
                         for_each_chunk(options.count, [&](auto first, auto count) {
                             in_process.trace(std::span(rays).subspan(first, count), first, answer);
                         });
                     }});
    sides.push_back({"service", [&](Answer& answer) { ask(*connection, closest, sent, answer); }});
    sides.push_back({"in_process_lidar", [&](Answer& answer) {
                         for_each_chunk(options.count, [&](auto first, auto count) {
                             const auto part = std::span(made).first(count);
                             generate_rays(lidar, first, part);
                             in_process.trace(part, first, answer);
                         });
                     }});
    sides.push_back(
        {"service_lidar", [&](Answer& answer) { ask(*connection, generated, none, answer); }});
    check_alike(sides[6], sides[7], options.count);
    check_alike(sides[8], sides[9], options.count);
    if (!options.sides.empty())
        std::erase_if(sides, [&](const Side& side) {
            return std::ranges::find(options.sides, side.name) == options.sides.end();
        });
    race_sides(options, sides);
    const double limit = crowded_from(sides);
    for (const Side& side : sides) {
        const auto against = std::ranges::find(sides, opponent_of(side.name), &Side::name);
        print(options, side, against == sides.end() ? nullptr : &*against, limit);
    }
}

}  // namespace
}  // namespace raynest::bench

int main(int argc, char** argv) {
    raynest::bench::Options options;
    CLI::App app("Example: service.py build/bin   (it starts a daemon for this program)");
    app.add_option("--server", options.server, "tcp://HOST:PORT or unix:PATH")->required();
    app.add_option("--daemon-pid", options.daemon_pid, "whose CPU time counts too")->required();
    app.add_option("--scene", options.scene, "SOURCE, as the daemon loaded it")->required();
    app.add_option("--name", options.name, "of the scene at the daemon")->required();
    app.add_option("--rays", options.rays, "primary, ao, shadow, diffuse or random");
    app.add_option("--count", options.count, "rays of a lap");
    app.add_option("--rounds", options.rounds, "laps of each side");
    app.add_option("--sides", options.sides, "only these")->delimiter(',');
    CLI11_PARSE(app, argc, argv);
    raynest::bench::run(std::move(options));
    return 0;
}
