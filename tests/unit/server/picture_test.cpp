// RENDER as the io thread sees it: what it reserves, and what its tasks do.
#include "engine/assets/image.h"
#include "server/handlers/handler.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

namespace raynest::server {
namespace {

using test::SmallDaemon;

Accepted ask(SmallDaemon& daemon, std::uint32_t width, std::uint32_t height,
             const std::string& encode) {
    wire::RenderT message;
    message.job = std::make_unique<wire::JobT>();
    message.job->scene = "forest";
    message.width = width;
    message.height = height;
    message.encode = encode;
    // From above a square, which does not fill the picture.
    message.camera = std::make_unique<wire::CameraT>();
    message.camera->look_at = true;
    message.camera->eye = std::make_unique<wire::Vec3>(0.5F, 0.5F, 3.0F);
    message.camera->at = std::make_unique<wire::Vec3>(0.5F, 0.5F, 0.0F);
    message.camera->up = std::make_unique<wire::Vec3>(0.0F, 1.0F, 0.0F);
    const auto frame = protocol::encode(1, message, daemon.limits).value();
    const auto opened = protocol::open<wire::Render>(frame, daemon.limits);
    REQUIRE(opened);
    auto answer = render(daemon.services, {{"me", 1}, 1, 1 << 20}, *opened);
    REQUIRE_MESSAGE(answer, (answer ? "" : answer.error().message));
    return std::move(std::get<Accepted>(*answer));
}

TEST_CASE("a picture reserves what its encoder takes") {
    SmallDaemon daemon;
    const std::uint64_t before = daemon.budget.used();
    const auto taken = [&](const std::string& encode) {
        const Accepted picture = ask(daemon, 100, 100, encode);
        return daemon.budget.used() - before;
    };
    const std::uint64_t raw = taken("raw");
    CHECK(raw >= 100 * 100 * (16 + 4 + 4));
    if (!images_available()) return;
    CHECK(taken("png") > raw);
    // Floats, their planes, their rows, and a file as large as any of those.
    CHECK(taken("exr") >= 100 * 100 * 16 * 4);
    CHECK(daemon.budget.used() == before);
}

TEST_CASE("a detached picture reserves what its answer is at most") {
    SmallDaemon daemon;
    const std::uint64_t raw = 100 * 100 * 4;
    for (const char* encode : {"raw", "png"}) {
        if (std::string(encode) == "png" && !images_available()) continue;
        const std::uint64_t reserved = ask(daemon, 100, 100, encode).result_bytes;
        CHECK(reserved >= raw);
        CHECK(reserved <= raw + 10'000);
    }
}

TEST_CASE("hits and misses of a picture are its pixels, and misses are the transparent ones") {
    SmallDaemon daemon;
    StopFlag stop(Clock::time_point::max());
    const auto job = ask(daemon, 64, 48, "raw").job;
    std::vector<std::byte> rgba;
    while (std::optional<Task> task = job->next()) {
        const auto frames = task->run(stop);
        REQUIRE(frames);
        REQUIRE(job->ended());
        for (const protocol::Frame& frame : *frames)
            rgba.insert(rgba.end(), frame.bulk.span().begin(), frame.bulk.span().end());
    }
    REQUIRE(job->finished());
    rgba.resize(std::size_t{64} * 48 * 4);  // less the padding
    std::uint64_t transparent = 0;
    for (std::size_t i = 3; i < rgba.size(); i += 4) transparent += rgba[i] == std::byte{0};

    const Frames farewell = job->farewell();
    REQUIRE(farewell.size() == 1);
    const auto done = protocol::open<wire::Done>(farewell[0], daemon.limits);
    REQUIRE(done);
    CHECK((*done)->rays() == 64 * 48);
    CHECK((*done)->hits() + (*done)->misses() == 64 * 48);
    CHECK((*done)->misses() == transparent);
    CHECK((*done)->hits() > 0);
    CHECK((*done)->misses() > 0);
}

TEST_CASE("a picture that nobody waits for is not encoded") {
    SmallDaemon daemon;
    StopFlag stop(Clock::time_point::max());
    const auto job = ask(daemon, 8, 8, "raw").job;
    REQUIRE(job->next()->run(stop));
    REQUIRE(job->ended());
    const auto encode = job->next();
    REQUIRE(encode);
    stop.request();
    const auto ended = encode->run(stop);
    REQUIRE_FALSE(ended);
    CHECK(ended.error().code == Code::cancelled);
}

}  // namespace
}  // namespace raynest::server
