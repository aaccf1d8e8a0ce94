// Tests crowds of failing or malicious clients: their effects are undone, and others are served.
#include "tests/integration/daemon.h"

#include <doctest/doctest.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <thread>
#include <utility>

namespace raynest::test {
namespace {

using protocol::Code;

constexpr std::uint64_t chunk = 16384;
constexpr std::chrono::milliseconds pause{20};

/// Sends one ray and reads its answer; other frames on the connection are skipped.
bool served(Peer& peer) {
    return peer.say(9, query_of(1)) && peer.send_frame(rays_frame(9, 0, 1)) &&
           (peer.read_until<wire::Done>(), true);
}

/// The resources that an idle daemon holds.
struct Baseline {
    explicit Baseline(Served& served)
        : memory(counter(served.peer, "memory_used_bytes")),
          descriptors(served.daemon.descriptors()) {}
    void check(Served& served) const {
        wait_for_idle(served.peer);
        CHECK(eventually([&] { return counter(served.peer, "memory_used_bytes") == memory; }));
        CHECK(eventually([&] { return served.daemon.descriptors() == descriptors; }));
        CHECK(served.peer.answers());
    }
    const double memory;
    const std::size_t descriptors;
};

/// Starts a query with an answer of over 100 MB and does not read it, or reads it byte by byte.
void read_slowly(Peer& peer, bool drips, const std::atomic<bool>& over) {
    const protocol::Limits limits;
    // Send as many rays as the credit allows, so that all of their answers are due.
    for (std::uint64_t sent = 0; sent + chunk * 32 <= limits.window_bytes; sent += chunk * 32)
        if (!peer.send_frame(rays_frame(5, sent / 32, chunk))) return;
    while (drips && !over && peer.receive_some(256)) std::this_thread::sleep_for(pause);
}

constexpr std::size_t slow_clients = sanitized ? 10 : 50;

/// A daemon whose share for one principal, four fifths, has room for the slow clients and for
/// `peer`.
struct ServedInHaste : Served {
    ServedInHaste()
        : Served({"--give-way-ms", "300", "--connections-max",
                  std::to_string((5 * (slow_clients + 1) + 3) / 4)}) {}
};

TEST_CASE_FIXTURE(ServedInHaste,
                  "fifty slow readers of 100 MB cost two windows each, and give way to newcomers") {
    constexpr std::size_t clients = slow_clients;
    const Baseline baseline(*this);
    const std::uint64_t before = daemon.resident_bytes();
    wire::HelloT hello;
    hello.window_bytes = protocol::Limits{}.window_bytes_max;
    wire::QueryT query = query_of(1'100'000);
    query.fields = {"t",   "prim",  "geom",     "path",     "inst",  "uid",   "uv",    "ng",
                    "hit", "front", "position", "material", "flags", "nodes", "boxes", "total"};
    std::vector<std::unique_ptr<Peer>> slow;
    std::vector<std::thread> readers;
    std::atomic<bool> over{false};
    for (std::size_t i = 0; i < clients; ++i) {
        slow.push_back(std::make_unique<Peer>(daemon));
        slow.back()->greet(hello);
        REQUIRE(slow.back()->say(5, query));
        readers.emplace_back(read_slowly, std::ref(*slow.back()), i % 2 == 0, std::cref(over));
    }
    std::size_t meanwhile = 0;
    double traced = -1;
    CHECK(eventually([&] {  // until no more fits into their windows
        std::this_thread::sleep_for(pause);
        const double before_request = counter(peer, "rays");
        meanwhile += served(peer);
        return std::exchange(traced, counter(peer, "rays")) == before_request;
    }));
    CHECK(counter(peer, "gave_way_connections") == 0);
    std::vector<std::unique_ptr<Peer>> newcomers;
    CHECK(eventually([&] {
        CHECK(peer.answers());  // this client does not pause
        auto newcomer = std::make_unique<Peer>(daemon);
        if (!newcomer->say(0, wire::HelloT{})) return false;
        const auto frame = newcomer->read();
        if (frame && protocol::open<wire::Welcome>(*frame))
            newcomers.push_back(std::move(newcomer));
        return newcomers.size() == clients;
    }));
    CHECK(counter(peer, "gave_way_connections") == clients);
    over = true;
    for (std::thread& reader : readers) reader.join();
    CHECK(meanwhile >= 1);
    newcomers.clear();
    const std::uint64_t growth = daemon.resident_bytes_max() - before;
    if (!sanitized) CHECK(growth < clients * 2 * protocol::Limits{}.window_bytes * 11 / 10);
    slow.clear();
    baseline.check(*this);
    tally("slow readers of 100 MB", clients,
          "gave way to newcomers, " + std::to_string(growth >> 20) + " MiB at most, " +
              std::to_string(meanwhile) + " requests of another client served meanwhile");
}

TEST_CASE_FIXTURE(Served, "a thousand clients that die mid-job leave nothing behind") {
    constexpr std::size_t clients = sanitized ? 200 : 1000;
    const Baseline baseline(*this);
    std::uint64_t before = 0;
    for (std::size_t i = 0; i < clients; ++i) {
        Peer guest(daemon);
        guest.greet();
        wire::RenderT render = endless_render();
        render.width = render.height = 256;
        REQUIRE(guest.say(5, render));
        REQUIRE(guest.say(6, query_of(2 * chunk)));
        REQUIRE(guest.send_frame(rays_frame(6, 0, chunk)));
        if (i % 3 == 0) guest.read_until<wire::Started>();
        if (i % 5 == 0) guest.send(std::string_view("RYN1 and half a head"));
        if (i % 2 == 0) guest.reset();
        // The first clients fill the buffers of the allocator and the workers.
        if (i == clients / 10) {
            baseline.check(*this);
            before = daemon.resident_bytes();
        }
    }
    baseline.check(*this);
    if (!sanitized) CHECK(daemon.resident_bytes() < before + (32 << 20));
    tally("clients that die mid-job", clients, "jobs, memory and descriptors are back");
}

TEST_CASE_FIXTURE(Served, "a storm of requests and their cancels ends each of them once") {
    constexpr std::size_t pairs = sanitized ? 1000 : 10'000;
    constexpr std::size_t batch = 100;
    const Baseline baseline(*this);
    auto storm = std::make_unique<Peer>(daemon);
    storm->greet();
    std::size_t cancelled = 0;
    std::size_t refused = 0;
    for (std::uint64_t first = 1; first <= pairs; first += batch) {
        for (std::uint64_t id = first; id < first + batch; ++id) {
            // Pictures keep their places until the workers have released them.
            REQUIRE(
                (id % 10 == 0 ? storm->say(id, endless_render()) : storm->say(id, query_of(1))));
            REQUIRE(storm->say(id, wire::CancelT{}));
        }
        for (std::size_t ends = 0; ends < batch; ++ends) {
            const auto code = storm->read_error();
            CAPTURE((code ? static_cast<int>(*code) : -1));
            REQUIRE((code == Code::cancelled || code == Code::quota ||
                     code == Code::resource_exhausted));
            ++(code == Code::cancelled ? cancelled : refused);
        }
        REQUIRE(served(peer));
    }
    storm.reset();
    CHECK(cancelled + refused == pairs);
    CHECK(cancelled >= pairs * 9 / 10);
    CHECK(counter(peer, "jobs_cancelled") == static_cast<double>(cancelled));
    baseline.check(*this);
    tally("submit and cancel", pairs,
          std::to_string(cancelled) + " cancelled, " + std::to_string(refused) +
              " refused, another client served after each hundred");
}

TEST_CASE("a daemon without descriptors tells newcomers, logs it rarely, and recovers") {
    constexpr std::size_t descriptors_max = 64;
    const auto start = std::chrono::steady_clock::now();
    const Daemon daemon({"--give-way-ms", "600000"}, descriptors_max);
    Peer first(daemon);
    first.greet();
    const auto is_welcome = [](Peer& guest) {
        static_cast<void>(guest.say(0, wire::HelloT{}));  // the connection may be closed already
        const auto frame = guest.read();
        REQUIRE(frame);
        return protocol::open<wire::Welcome>(*frame).has_value();
    };
    std::vector<std::unique_ptr<Peer>> crowd;
    std::size_t refused = 0;
    for (std::size_t i = 0; i < 2 * descriptors_max; ++i) {
        crowd.push_back(std::make_unique<Peer>(daemon));
        if (!is_welcome(*crowd.back())) ++refused;
    }
    CHECK(refused >= descriptors_max);
    CHECK(refused < 2 * descriptors_max);
    CHECK(first.answers());
    crowd.clear();
    CHECK(eventually([&] {
        Peer late(daemon);
        return is_welcome(late);
    }));
    const std::size_t lines = daemon.logged("descriptors_used_up");
    CHECK(lines >= 1);
    const std::chrono::duration<double> time = std::chrono::steady_clock::now() - start;
    CHECK(static_cast<double>(lines) <= 1 + time.count());
    tally("connections at 64 descriptors", 2 * descriptors_max,
          std::to_string(refused) + " told that there is none, served again once some had left, " +
              std::to_string(lines) + " lines in the log");
}

}  // namespace
}  // namespace raynest::test
