#include "client/requests/query.h"

#include "tests/unit/client/fake_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstring>
#include <string>
#include <vector>

using namespace raynest;
using client::Connection;
using client::FakeDaemon;
using client::Peer;
using client::QueryChunk;
using client::Ray;

namespace {

client::RaySource some_rays(std::size_t count) {
    std::vector<client::WorldRay> rays(count);
    for (std::size_t i = 0; i < count; ++i)
        rays[i] = {static_cast<double>(i), 0, 0, 0, 0, 0, 1, 100};
    return client::RaySource(rays);
}

wire::QueryT query_of(const std::string& kind, std::uint64_t count) {
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.kind = kind;
    query.ray_count = count;
    return query;
}

/// Sends a chunk in which column t of ray i is i.
void send_answers(Peer& peer, std::uint64_t id, std::uint64_t first, std::uint32_t count) {
    protocol::Bulk bulk;
    bulk.add("t", wire::Dtype::f32, 1, count);
    bulk.allocate();
    for (std::uint32_t i = 0; i < count; ++i)
        bulk.block_as<float>(0)[i] = static_cast<float>(first + i);
    wire::ChunkT chunk;
    chunk.first_ray = first;
    chunk.count = count;
    peer.send(id, std::move(chunk), std::move(bulk));
}

/// Runs a query of `count` rays against `script`, which gets the query's id after its first frame.
client::Result<client::Outcome> run(
    const std::string& kind, std::size_t count,
    const std::function<void(Peer&, std::uint64_t)>& script,
    const std::function<client::Result<void>(const QueryChunk&)>& consume,
    std::uint64_t window_bytes = 8U << 20) {
    FakeDaemon daemon([&](Peer& peer) {
        peer.welcome(window_bytes);
        script(peer, peer.receive().header.request_id);
    });
    const auto connection = Connection::open(daemon.uri(), "");
    REQUIRE(connection);
    client::Progress progress(client::Progress::Style::none);
    return client::run_query(**connection, query_of(kind, count), some_rays(count), progress,
                             consume);
}

client::Result<void> ignore(const QueryChunk&) {
    return {};
}

/// Sends one chunk made by `build`, then Done; true if the client accepts it.
bool takes(const std::string& kind, std::uint32_t count,
           const std::function<void(protocol::Bulk&)>& build, std::uint64_t first = 0) {
    const auto outcome = run(
        kind, 2,
        [&](Peer& peer, std::uint64_t id) {
            protocol::Bulk bulk;
            build(bulk);
            wire::ChunkT chunk;
            chunk.first_ray = first;
            chunk.count = count;
            peer.send(id, wire::StartedT{});
            peer.send(id, std::move(chunk), std::move(bulk));
            peer.send(id, wire::DoneT{});
            peer.receive();
        },
        ignore);
    return outcome.has_value();
}

void add_splits(protocol::Bulk& bulk, const std::vector<std::uint64_t>& splits,
                std::uint64_t hits) {
    bulk.add("ray_splits", wire::Dtype::u64, 1, splits.size());
    bulk.add("t", wire::Dtype::f32, 1, hits);
    bulk.allocate();
    std::memcpy(bulk.block(0).data(), splits.data(), splits.size() * sizeof(std::uint64_t));
    std::ranges::fill(bulk.block(1), std::byte{0});
}

}  // namespace

TEST_CASE("chunks that come in any order are consumed in ray order") {
    std::vector<float> seen;
    const auto outcome = run(
        "closest", 10,
        [](Peer& peer, std::uint64_t id) {
            peer.receive();
            wire::StartedT started;
            started.intersector = "opaque";
            started.traversal = "single";
            peer.send(id, started);
            send_answers(peer, id, 6, 4);
            send_answers(peer, id, 0, 1);
            send_answers(peer, id, 3, 3);
            send_answers(peer, id, 1, 2);
            wire::DoneT done;
            done.rays = 10;
            done.traversal = "stream";
            peer.send(id, done);
        },
        [&](const QueryChunk& chunk) -> client::Result<void> {
            CHECK(chunk.first_ray == seen.size());
            for (const float t : chunk.columns[0].values<float>()) seen.push_back(t);
            return {};
        });
    REQUIRE(outcome);
    CHECK(outcome->intersector == "opaque");
    CHECK(outcome->traversal == "stream");
    REQUIRE(seen.size() == 10);
    for (std::size_t i = 0; i < 10; ++i) CHECK(seen[i] == static_cast<float>(i));
}

TEST_CASE("rays are sent within the daemon's credit and in frames of its size") {
    constexpr std::uint64_t window = 64U << 10;  // 2048 rays
    constexpr std::size_t count = 10000;
    std::uint64_t most_outstanding = 0;
    std::uint64_t received = 0;
    const auto outcome = run(
        "closest", count,
        [&](Peer& peer, std::uint64_t id) {
            std::uint64_t outstanding = 0;
            while (received < count) {
                const protocol::Frame frame = peer.receive();
                const auto rays = protocol::open<wire::QueryRays>(frame);
                if (!rays) return;
                CHECK((*rays)->first_ray() == received);
                CHECK(rays->blocks[0].values<float>()[0] == static_cast<float>(received));
                received += rays->blocks[0].count;
                outstanding += frame.header.bulk_bytes;
                most_outstanding = std::max(most_outstanding, outstanding);
                // Grant late: only when the client has stopped for lack of credit.
                if (outstanding + frame.header.bulk_bytes > window) {
                    wire::CreditT credit;
                    credit.bytes = std::exchange(outstanding, 0);
                    peer.send(id, credit);
                }
            }
            peer.send(id, wire::StartedT{});
            for (std::uint64_t first = 0; first < count; first += 5000)
                send_answers(peer, id, first, 5000);
            peer.send(id, wire::DoneT{});
        },
        ignore, window);
    CHECK(outcome.has_value());
    CHECK(received == count);
    CHECK(most_outstanding <= window);
}

TEST_CASE("columns of another length than their rays or hits are refused") {
    const auto t_column = [](std::uint64_t count) {
        return [count](protocol::Bulk& bulk) {
            bulk.add("t", wire::Dtype::f32, 1, count);
            bulk.allocate();
            std::ranges::fill(bulk.block(0), std::byte{0});
        };
    };
    CHECK(takes("closest", 2, t_column(2)));
    CHECK(!takes("closest", 2, t_column(1)));
    CHECK(!takes("closest", 2, t_column(3)));
    CHECK(!takes("closest", 1, t_column(1)));     // Done, but a ray has no answer
    CHECK(!takes("closest", 3, t_column(3)));     // more rays than were sent
    CHECK(!takes("closest", 1, t_column(1), 2));  // a ray that was not sent
    CHECK(!takes("closest", 0, t_column(0)));
}

TEST_CASE("ray_splits must be there, begin at 0, rise and fit the columns") {
    const auto splits = [](const std::vector<std::uint64_t>& values, std::uint64_t hits) {
        return [=](protocol::Bulk& bulk) { add_splits(bulk, values, hits); };
    };
    CHECK(takes("multi", 2, splits({0, 1, 4}, 4)));
    CHECK(takes("multi", 2, splits({0, 0, 0}, 0)));
    CHECK(takes("all", 2, splits({0, 1, 4}, 4)));
    CHECK(!takes("multi", 2, splits({0, 1, 4}, 3)));
    CHECK(!takes("multi", 2, splits({0, 1}, 1)));
    CHECK(!takes("multi", 2, splits({1, 1, 4}, 4)));
    CHECK(!takes("multi", 2, splits({0, 5, 4}, 4)));
    CHECK(!takes("multi", 2, [](protocol::Bulk& bulk) {
        bulk.add("t", wire::Dtype::f32, 1, 2);
        bulk.allocate();
        std::ranges::fill(bulk.block(0), std::byte{0});
    }));
}

TEST_CASE("the daemon states the number of rows for rays that it makes and for tables") {
    const auto run_made = [](const std::string& reduce, std::uint64_t announced,
                             std::uint64_t rows) {
        FakeDaemon daemon([&](Peer& peer) {
            peer.welcome(8U << 20);
            const std::uint64_t id = peer.receive().header.request_id;
            wire::StartedT started;
            started.rays = announced;
            peer.send(id, started);
            send_answers(peer, id, 0, 7);
            wire::DoneT done;
            done.rows = rows;
            peer.send(id, done);
            peer.receive();
        });
        const auto connection = Connection::open(daemon.uri(), "");
        REQUIRE(connection);
        client::Progress progress(client::Progress::Style::none);
        wire::QueryT query = query_of("closest", 0);
        query.generator = std::make_unique<wire::GeneratorT>();
        query.generator->kind = "camera";
        query.reduce = reduce;
        return client::run_query(**connection, query, some_rays(0), progress, ignore).has_value();
    };
    CHECK(run_made("", 7, 7));
    CHECK(!run_made("", 8, 8));  // a row is missing
    CHECK(!run_made("", 6, 6));  // there is one too many
    CHECK(run_made("visible_pixels", 100, 7));
    CHECK(!run_made("visible_pixels", 100, 8));
    CHECK(!run_made("visible_pixels", 6, 7));
}

TEST_CASE("columns of a wrong type, and splits without hits to count, are refused") {
    const auto column = [](const char* name, wire::Dtype dtype, std::uint32_t width) {
        return [=](protocol::Bulk& bulk) {
            bulk.add(name, dtype, width, 2);
            bulk.allocate();
            std::ranges::fill(bulk.block(0), std::byte{0});
        };
    };
    CHECK(takes("closest", 2, column("position", wire::Dtype::f32, 3)));
    CHECK(!takes("closest", 2, column("position", wire::Dtype::u8, 1)));
    CHECK(!takes("closest", 2, column("t", wire::Dtype::f32, 2)));
    CHECK(takes("closest", 2, column("cracks", wire::Dtype::u64, 1)));  // an output
    for (const std::uint64_t hits : {std::uint64_t{4}, ~std::uint64_t{0}})
        CHECK(takes("multi", 2, [&](protocol::Bulk& bulk) {
                  bulk.add("ray_splits", wire::Dtype::u64, 1, 3);
                  bulk.allocate();
                  bulk.block_as<std::uint64_t>(0)[0] = bulk.block_as<std::uint64_t>(0)[1] = 0;
                  bulk.block_as<std::uint64_t>(0)[2] = hits;
              }) == (hits == 4));
}

TEST_CASE("an answer that comes twice is refused") {
    const auto outcome = run(
        "closest", 4,
        [](Peer& peer, std::uint64_t id) {
            send_answers(peer, id, 2, 1);
            send_answers(peer, id, 2, 1);
            peer.receive();
        },
        ignore);
    CHECK(!outcome);
}

TEST_CASE("a refusal by the consumer ends the query") {
    const auto outcome = run(
        "closest", 1,
        [](Peer& peer, std::uint64_t id) {
            send_answers(peer, id, 0, 1);
            peer.receive();
        },
        [](const QueryChunk&) -> client::Result<void> {
            return client::fail(protocol::Exit::failed, "disk full");
        });
    REQUIRE(!outcome);
    CHECK(outcome.error().message == "disk full");
}
