// Sends rays to a real daemon in every form: whole, without the values that a frame's rays share,
// and traced together with other clients' rays.
#include "tests/integration/daemon.h"

#include <doctest/doctest.h>
#include <signal.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

namespace raynest::test {
namespace {

using protocol::Code;

constexpr std::size_t ray_values = 8;  // ox oy oz tmin dx dy dz tmax

std::span<float> values_of(protocol::Frame& frame) {
    return {reinterpret_cast<float*>(frame.bulk.data()),
            frame.bulk.size() / sizeof(float) / ray_values * ray_values};
}

/// Returns a hundred rays that miss, or hit another place for each `number`.
protocol::Frame rays_of(std::uint64_t number) {
    protocol::Frame frame = rays_frame(5, 0, 100);
    const std::span<float> values = values_of(frame);
    for (std::size_t i = 0; i < 100; ++i)
        values[ray_values * i] = 0.02F * static_cast<float>(i) + static_cast<float>(number) - 9;
    return frame;
}

struct Fan {
    float x = 0;
    float tmin = 0;
    float tmax = std::numeric_limits<float>::infinity();
};

/// Returns a hundred rays from one point above the scene, some of which hit.
protocol::Frame rays_of(const Fan& fan, std::uint64_t first = 0) {
    protocol::Frame frame = rays_frame(5, first, 100);
    const std::span<float> values = values_of(frame);
    for (std::size_t i = 0; i < 100; ++i) {
        float* const ray = &values[ray_values * i];
        ray[0] = fan.x;
        ray[3] = fan.tmin;
        ray[4] = 0.0005F * static_cast<float>(i) - 0.02F;
        ray[7] = fan.tmax;
    }
    return frame;
}

/// Shortens the rays to 6 or 3 values each; the frame takes the other values from the first ray.
protocol::Frame shortened(protocol::Frame frame, std::uint32_t width) {
    const std::span<const float> values = values_of(frame);
    const auto whole = protocol::open<wire::QueryRays>(frame);
    REQUIRE(whole);
    const std::uint64_t count = whole->blocks[0].count;
    protocol::Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, width, count);
    bulk.allocate();
    float* out = bulk.block_as<float>(0).data();
    for (std::size_t i = 0; i < count; ++i) {
        const float* const ray = &values[ray_values * i];
        if (width == 6) out = std::copy_n(ray, 3, out);
        out = std::copy_n(ray + 4, 3, out);
    }
    wire::QueryRaysT message;
    message.first_ray = (*whole)->first_ray();
    if (width == 3) message.origin = std::make_unique<wire::Vec3>(values[0], values[1], values[2]);
    message.tmin = values[3];
    message.tmax = std::isinf(values[7]) ? 0 : values[7];
    return protocol::encode(frame.header.request_id, std::move(message), std::move(bulk)).value();
}

/// Returns the columns chunk by chunk, in the order of their rays.
std::vector<std::byte> columns_of(Peer& peer) {
    std::map<std::uint64_t, protocol::Frame> chunks;
    for (;;) {
        std::optional<protocol::Frame> frame = peer.read();
        REQUIRE(frame);
        if (frame->header.type == static_cast<std::uint16_t>(wire::Message::Done)) break;
        REQUIRE(frame->header.type != static_cast<std::uint16_t>(wire::Message::Error));
        if (const auto chunk = protocol::open<wire::Chunk>(*frame))
            chunks.emplace((*chunk)->first_ray(), std::move(*frame));
    }
    std::vector<std::byte> columns;
    for (const auto& [first, frame] : chunks)
        columns.insert(columns.end(), frame.bulk.data(), frame.bulk.data() + frame.bulk.size());
    return columns;
}

class Asked : public Served {
public:
    /// Returns the query's answer to rays in these frames.
    template <class... Frames>
    std::vector<std::byte> answer(const Frames&... frames) {
        REQUIRE(peer.say(5, query));
        for (const protocol::Frame* rays : {&frames...}) REQUIRE(peer.send_frame(*rays));
        return columns_of(peer);
    }

    wire::QueryT query = query_of(100);
};

constexpr float open_end = std::numeric_limits<float>::infinity();

TEST_CASE_FIXTURE(Asked, "what the rays of a frame have in common need not come with each") {
    // Hits lie between 980 and 998, so each range has another answer.
    constexpr std::array fans = {Fan{0, 0, open_end}, Fan{0, 0, 989}, Fan{0, 989, open_end},
                                 Fan{0, 985, 990}, Fan{3, 0, open_end}};
    SUBCASE("rays") {
        std::vector<std::vector<std::byte>> answers;
        for (const Fan& fan : fans) {
            answers.push_back(answer(rays_of(fan)));
            CHECK(answer(shortened(rays_of(fan), 6)) == answers.back());
            CHECK(answer(shortened(rays_of(fan), 3)) == answers.back());
        }
        for (const auto& columns : answers) CHECK(std::ranges::count(answers, columns) == 1);
    }
    SUBCASE("points") {
        query.generator = std::make_unique<wire::GeneratorT>();
        query.generator->kind = "hemisphere";
        query.generator->settings = {"samples=3"};
        std::vector<std::vector<std::byte>> answers;
        for (const Fan& fan : {Fan{0, 0, open_end}, Fan{0, 0, 1}, Fan{3, 0, open_end}}) {
            answers.push_back(answer(rays_of(fan)));
            CHECK(answer(shortened(rays_of(fan), 6)) == answers.back());
            CHECK(answer(shortened(rays_of(fan), 3)) == answers.back());
        }
        for (const auto& columns : answers) CHECK(std::ranges::count(answers, columns) == 1);
    }
    SUBCASE("each frame says it for itself") {
        query.ray_count = 300;
        const auto frame = [&](std::size_t number) {
            return rays_of(fans[number + 1], 100 * number);
        };
        CHECK(answer(shortened(frame(0), 3), shortened(frame(1), 6), shortened(frame(2), 3)) ==
              answer(frame(0), frame(1), frame(2)));
    }
}

/// Returns a frame of a hundred rays of `width` values, with an unchanged message.
protocol::Frame frame_of(wire::QueryRaysT message, std::uint32_t width) {
    protocol::Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, width, 100);
    bulk.allocate();
    std::ranges::fill(bulk.block_as<float>(0), 1.0F);
    return protocol::encode(5, std::move(message), std::move(bulk)).value();
}

TEST_CASE_FIXTURE(Asked, "a frame states exactly the values that its rays lack") {
    const auto refused = [&](std::uint32_t width, bool origin, float tmin, float tmax) {
        wire::QueryRaysT message;
        if (origin) message.origin = std::make_unique<wire::Vec3>(0.0F, 0.0F, 0.0F);
        message.tmin = tmin;
        message.tmax = tmax;
        REQUIRE(peer.say(5, query));
        REQUIRE(peer.send_frame(frame_of(std::move(message), width)));
        return peer.read_error() == Code::invalid_field;
    };
    CHECK(refused(3, false, 0, 0));
    CHECK(refused(6, true, 0, 0));
    CHECK(refused(8, true, 0, 0));
    CHECK(refused(8, false, 1, 0));
    CHECK(refused(8, false, 0, 1));
    CHECK(refused(1, true, 0, 0));
    CHECK(peer.answers());
}

TEST_CASE_FIXTURE(Asked, "an invalid origin or range gives misses with flag 1") {
    query.fields = {"flags"};
    const float nan = std::numeric_limits<float>::quiet_NaN();
    for (const Fan& fan : {Fan{nan, 0, 1}, Fan{open_end, 0, 1}, Fan{0, -1, 1}, Fan{0, 2, 1},
                           Fan{0, nan, 1}, Fan{0, 0, nan}}) {
        const std::vector<std::byte> flags = answer(shortened(rays_of(fan), 3));
        CHECK(std::count(flags.begin(), flags.end(), std::byte{1}) == 100);
    }
}

TEST_CASE_FIXTURE(Served,
                  "small requests that come together are traced together, each for itself") {
    constexpr std::size_t clients = 18;
    std::vector<std::unique_ptr<Peer>> peers;
    std::vector<std::vector<std::byte>> alone;
    for (std::size_t i = 0; i < clients; ++i) {
        peers.push_back(std::make_unique<Peer>(daemon));
        peers.back()->greet();
        REQUIRE(peers[i]->say(5, query_of(100)));
        REQUIRE(peers[i]->send_frame(rays_of(i)));
        alone.push_back(columns_of(*peers[i]));
    }
    CHECK(counter(peer, "tasks_coalesced") == 0);
    CHECK(alone.front() != alone.back());
    // All wait in their sockets when the daemon reads again. If it has too little processor time to
    // read two in one turn, the next round may succeed.
    CHECK(eventually([&] {
        daemon.signal(SIGSTOP);
        for (std::size_t i = 0; i < clients; ++i) {
            REQUIRE(peers[i]->say(5, query_of(100)));
            REQUIRE(peers[i]->send_frame(i % 2 == 0 ? rays_of(i) : shortened(rays_of(i), 6)));
        }
        daemon.signal(SIGCONT);
        for (std::size_t i = 0; i < clients; ++i) CHECK(columns_of(*peers[i]) == alone[i]);
        return counter(peer, "tasks_coalesced") >= 2;
    }));
}

}  // namespace
}  // namespace raynest::test
