// raynest-load-test SCENE: measures round trips and throughput of queries, beside bare sockets.
#include "client/arguments/shared_options.h"
#include "client/ground/json.h"
#include "client/net/access.h"
#include "client/net/connection.h"
#include "client/output/output.h"
#include "client/requests/job.h"
#include "protocol/limits.h"
#include "tests/bench/load_test/driver.h"
#include "tests/bench/load_test/echo.h"

#include <CLI/CLI.hpp>

#include <array>
#include <cmath>
#include <cstdio>
#include <exception>
#include <iostream>
#include <memory>
#include <random>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace raynest::client {
namespace {

struct LoadTestOptions {
    std::string server;
    AccessOptions access;
    bool json = false;
    JobOptions job;
    std::string kind = "closest";
    std::vector<std::string> fields;
    std::uint32_t max_hits = 0;  ///< 0: the kind's default
    std::uint32_t clients = 1;
    std::uint32_t rays = 1;  ///< per request
    double seconds = 5;
    double rate = 0;  ///< requests per second of all clients together; 0: as many as possible
};

/// Daemon and controls take turns of about this length, so that other work on the machine disturbs
/// all of them alike.
constexpr double turn_seconds = 0.5;

/// Makes rays from outside through points of the scene's box. A seed gives the same rays anywhere.
void aim(std::span<Ray> rays, const wire::SceneInfo& info, std::uint32_t seed) {
    std::mt19937 bits(seed);
    const auto unit = [&] { return static_cast<float>(bits() >> 8) * 0x1p-24F; };
    const wire::Vec3 none(0, 0, 0);
    const wire::Vec3& low = info.box_min() != nullptr ? *info.box_min() : none;
    const wire::Vec3& high = info.box_max() != nullptr ? *info.box_max() : none;
    const float span = 1 + (high.x() - low.x()) + (high.y() - low.y()) + (high.z() - low.z());
    for (Ray& ray : rays) {
        const float turn = 6.2831853F * unit();
        const float up = 2 * unit() - 1;
        const float across = std::sqrt(1 - up * up);
        const std::array<float, 3> d = {across * std::cos(turn), up, across * std::sin(turn)};
        const std::array<float, 3> at = {low.x() + unit() * (high.x() - low.x()),
                                         low.y() + unit() * (high.y() - low.y()),
                                         low.z() + unit() * (high.z() - low.z())};
        ray = {at[0] - span * d[0],
               at[1] - span * d[1],
               at[2] - span * d[2],
               0,
               d[0],
               d[1],
               d[2],
               2 * span};
    }
}

void append(std::vector<std::byte>& bytes, const protocol::Frame& frame) {
    std::array<std::byte, protocol::header_bytes> header{};
    protocol::write_header(frame.header, header);
    for (const std::span<const std::byte> part :
         {std::span<const std::byte>(header), frame.control.span(), frame.bulk.span()})
        bytes.insert(bytes.end(), part.begin(), part.end());
}

/// Returns the bytes of a query and its rays.
Result<std::vector<std::byte>> request_bytes(const LoadTestOptions& options,
                                             const wire::SceneInfo& info, std::uint32_t seed) {
    wire::QueryT query;
    query.job = job_message(options.job);
    query.kind = options.kind;
    query.fields = options.fields;
    query.max_hits = options.max_hits;
    query.ray_count = options.rays;
    protocol::Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, 8, options.rays);
    bulk.allocate();
    aim(bulk.block_as<Ray>(0), info, seed);

    std::vector<std::byte> bytes;
    for (const auto& frame :
         {protocol::encode(1, query), protocol::encode(1, wire::QueryRaysT{}, std::move(bulk))}) {
        if (!frame) return tl::unexpected<Failure>(failure(frame.error()));
        append(bytes, *frame);
    }
    return bytes;
}

/// One of the three measured servers: the daemon or a control.
struct Side {
    const char* name;
    const char* key;
    Driver driver;
    LoadTestStatistics statistics;
};

/// A server that the daemon is compared with.
struct Control {
    const char* name;
    const char* key;
    std::unique_ptr<Echo> (*make)(std::vector<Descriptor>, EchoScript);
};
constexpr std::array controls = {Control{"asio echo", "asio_echo", echo_by_asio},
                                 Control{"blocking echo", "blocking_echo", echo_by_threads}};

double per_second(std::uint64_t count, const LoadTestStatistics& statistics) {
    return statistics.time.count() > 0 ? static_cast<double>(count) / statistics.time.count() : 0;
}

Json side_json(const Side& side, std::uint32_t rays) {
    const Latencies& latencies = side.statistics.latencies;
    const std::uint64_t answered = side.statistics.answered();
    return Json{{"requests", answered},
                {"refused", side.statistics.refused},
                {"missed", side.statistics.missed},
                {"p50_us", latencies.percentile_us(0.5)},
                {"p99_us", latencies.percentile_us(0.99)},
                {"p999_us", latencies.percentile_us(0.999)},
                {"max_us", latencies.max_us()},
                {"requests_per_second", per_second(answered, side.statistics)},
                {"rays_per_second", per_second(answered * rays, side.statistics)},
                {"bytes_per_second", per_second(side.statistics.bytes, side.statistics)}};
}

/// Returns a row of the table; only an open loop has the column MISSED.
std::vector<std::string> side_row(const Side& side, const LoadTestOptions& options) {
    const Latencies& latencies = side.statistics.latencies;
    const std::uint64_t answered = side.statistics.answered();
    const auto number = [](double value, int digits) {
        std::array<char, 32> text{};
        std::snprintf(text.data(), text.size(), "%.*f", digits, value);
        return std::string(text.data());
    };
    std::vector<std::string> row = {
        side.name,
        number(latencies.percentile_us(0.5), 1),
        number(latencies.percentile_us(0.99), 1),
        number(latencies.percentile_us(0.999), 1),
        number(per_second(answered, side.statistics), 0),
        number(per_second(answered * options.rays, side.statistics), 0),
        number(per_second(side.statistics.bytes, side.statistics) / 1e6, 1),
        std::to_string(side.statistics.refused)};
    if (options.rate > 0) row.push_back(std::to_string(side.statistics.missed));
    return row;
}

/// Fails if no request was answered.
Result<void> check_answered(const LoadTestStatistics& statistics) {
    if (statistics.answered() != 0 || !statistics.refusal) return {};
    Failure refusal = *statistics.refusal;
    refusal.message = "all requests were refused: " + refusal.message;
    return tl::unexpected<Failure>(std::move(refusal));
}

/// Compares the daemon with the echo. If one of them could not keep up with the rate, says so
/// instead: times of an overloaded server only tell how long it was overloaded.
std::string verdict(const Side& daemon, const Side& echo, double ratio, double rate) {
    std::array<char, 160> line{};
    const Side& slow = daemon.statistics.missed != 0 ? daemon : echo;
    const double most = per_second(slow.statistics.answered(), slow.statistics);
    if (slow.statistics.missed == 0)
        std::snprintf(line.data(), line.size(), "p50 is %.2f times that of the Asio echo", ratio);
    else
        std::snprintf(
            line.data(), line.size(),
            "%s answered %.0f of %.10g requests per second: lower --rate, or add --clients",
            slow.name, most, rate);
    return line.data();
}

void declare(CommandLine& line, LoadTestOptions& load_test) {
    line.add_option("--server", load_test.server, "tcp://HOST:PORT or unix:PATH")
        .environment_name("RAYNEST_SERVER");
    line.add_option("--ca", load_test.access.tls.ca, "PEM file of the CAs to trust with tls://");
    line.add_option("--token-file", load_test.access.token_file, "file with the token, mode 0600");
    line.add_flag("--json", load_test.json, "print answers and errors as JSON");
    add_job(line, load_test.job);
    add_kind(line, load_test.kind, load_test.max_hits, load_test.fields);
    line.add_whole("--clients", load_test.clients, 1U, 1000U, "connections at the same time (1)");
    line.add_whole("--rays", load_test.rays, 1U,
                   static_cast<std::uint32_t>(protocol::Limits{}.chunk_rays_max),
                   "rays of each request (1)");
    line.add_number("--seconds", load_test.seconds, 0.1, 86400.0,
                    "a number of seconds from 0.1 to 86400",
                    "time to measure the daemon, and then each control (5)");
    line.add_number(
        "--rate", load_test.rate, 0.1, 1.0e7, "a number from 0.1 to 10000000",
        "requests per second of all clients (else each client sends when it has its "
        "answer). Latency counts from a request's scheduled time; one that is 5 s late is MISSED");
}

Result<void> run(const LoadTestOptions& options) {
    const std::string server = options.server.empty() ? std::string(default_uri) : options.server;
    const auto access = find_access(server, options.access);
    if (!access) return tl::unexpected<Failure>(access.error());
    const auto first = Connection::open(server, *access);
    if (!first) return tl::unexpected<Failure>(first.error());
    if ((*first)->socket() < 0)
        return fail(Exit::usage, "a load test writes to bare sockets: use tcp:// or unix:");
    wire::InfoT question;
    question.scene = options.job.scene;
    const auto info = ask<wire::SceneInfo>(**first, question);
    if (!info) return tl::unexpected<Failure>(info.error());

    std::vector<std::unique_ptr<Connection>> connections;
    std::vector<std::vector<std::byte>> requests;
    std::vector<int> sockets;
    for (std::uint32_t i = 0; i < options.clients; ++i) {
        auto connection = Connection::open(server, *access);
        if (!connection) return tl::unexpected<Failure>(connection.error());
        auto request = request_bytes(options, *info->message.table, i);
        if (!request) return tl::unexpected<Failure>(request.error());
        sockets.push_back((*connection)->socket());
        connections.push_back(std::move(*connection));
        requests.push_back(std::move(*request));
    }
    const std::vector<std::span<const std::byte>> spans(requests.begin(), requests.end());

    std::vector<Side> sides;
    sides.push_back({"raynestd", "daemon", Driver(sockets, spans), {}});
    const auto turn = [](Side& side, double seconds, double rate) {
        return side.driver.run(std::chrono::duration_cast<std::chrono::nanoseconds>(
                                   std::chrono::duration<double>(seconds)),
                               rate, side.statistics);
    };
    // The first turn warms up and records the reply that the controls will send.
    if (auto warm = turn(sides[0], std::min(turn_seconds, options.seconds), 0); !warm) return warm;
    if (auto answered = check_answered(sides[0].statistics); !answered) return answered;
    sides[0].statistics = {};

    const EchoScript script{requests[0].size(), sides[0].driver.sample()};
    std::vector<std::unique_ptr<Echo>> echoes;
    std::vector<std::vector<Descriptor>> ends;
    for (const Control& control : controls) {
        auto pairs = connect_pairs(sockets[0], sockets.size());
        if (!pairs) return tl::unexpected<Failure>(pairs.error());
        echoes.push_back(control.make(std::move(pairs->far), script));
        std::vector<int> near;
        for (const Descriptor& end : pairs->near) near.push_back(end.number());
        ends.push_back(std::move(pairs->near));
        sides.push_back({control.name, control.key, Driver(near, spans), {}});
    }

    const double turns = std::ceil(options.seconds / turn_seconds);
    for (double i = 0; i < turns; ++i)
        for (Side& side : sides)
            if (auto done = turn(side, options.seconds / turns, options.rate); !done) return done;
    if (auto answered = check_answered(sides[0].statistics); !answered) return answered;

    const double echo_us = sides[1].statistics.latencies.percentile_us(0.5);
    const double ratio =
        echo_us > 0 ? sides[0].statistics.latencies.percentile_us(0.5) / echo_us : 0;
    if (options.json) {
        Json json{{"scene", options.job.scene},
                  {"kind", options.kind},
                  {"clients", options.clients},
                  {"rays", options.rays},
                  {"rate", options.rate},
                  {"request_bytes", script.request_bytes},
                  {"reply_bytes", script.reply.size()}};
        for (const Side& side : sides) json[side.key] = side_json(side, options.rays);
        const bool kept_up = sides[0].statistics.missed == 0 && sides[1].statistics.missed == 0;
        json["ratio_to_asio_echo"] = kept_up ? Json(ratio) : Json(nullptr);
        print_json(json);
        return {};
    }
    std::vector<std::vector<std::string>> rows = {
        {"", "P50_US", "P99_US", "P99.9_US", "REQUESTS/S", "RAYS/S", "MB/S", "REFUSED"}};
    if (options.rate > 0) rows[0].emplace_back("MISSED");
    for (const Side& side : sides) rows.push_back(side_row(side, options));
    print_table(rows);
    std::cout << script.request_bytes << " bytes to ask, " << script.reply.size() << " to answer; "
              << verdict(sides[0], sides[1], ratio, options.rate) << '\n';
    return {};
}

int end_with(const Failure& failure, bool json) {
    std::cout.flush();
    std::cerr << describe(failure, json) << '\n';
    return static_cast<int>(failure.exit);
}

}  // namespace
}  // namespace raynest::client

int main(int argc, char** argv) {
    using namespace raynest::client;
    LoadTestOptions options;
    CLI::App app(
        "Measures round trips and throughput of queries, beside bare sockets, as in\n"
        "  raynest-load-test forest --clients 8 --rays 64 --seconds 10");
    CommandLine line(&app);
    declare(line, options);
    try {
        app.parse(argc, argv);
        const auto done = run(options);
        return done ? 0 : end_with(done.error(), options.json);
    } catch (const CLI::CallForHelp& help) {
        return app.exit(help);
    } catch (const CLI::ParseError& error) {
        return end_with(failure(Exit::usage, error.what()), options.json);
    } catch (const std::exception& thrown) {
        return end_with(failure(Exit::failed, thrown.what()), options.json);
    }
}
