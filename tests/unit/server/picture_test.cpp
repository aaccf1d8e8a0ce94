// RENDER on the io thread: the memory that it reserves, and the work of its tasks.
#include "engine/assets/images/image.h"
#include "engine/integrators/film.h"
#include "server/execution/choose_backends.h"
#include "server/jobs/films/film_options.h"
#include "server/jobs/picture_job.h"
#include "server/requests/request.h"
#include "server/requests/words/generator.h"
#include "server/requests/words/make_plan.h"
#include "server/requests/words/picture_request.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <cmath>
#include <memory>
#include <optional>
#include <vector>

namespace raynest::server {
namespace {

using test::from_above;
using test::SmallDaemon;

JobSubmission ask(SmallDaemon& daemon, std::uint32_t width, std::uint32_t height,
                  const std::string& encode) {
    wire::RenderT message;
    message.job = std::make_unique<wire::JobT>();
    message.job->scene = "forest";
    message.width = width;
    message.height = height;
    message.encode = encode;
    message.camera = from_above();
    const auto frame = protocol::encode(1, message, daemon.limits).value();
    const auto opened = protocol::open<wire::Render>(frame, daemon.limits);
    REQUIRE(opened);
    auto answer = render(daemon.services, {{"me", 1}, 1, 1 << 20}, *opened);
    REQUIRE_MESSAGE(answer, (answer ? "" : answer.error().message));
    return std::move(std::get<JobSubmission>(*answer));
}

TEST_CASE("a film reserves its file, and what it grows or is copied in") {
    constexpr ImageSize size{100, 50};
    const auto bytes = [&](std::string_view encode) { return film_job_bytes(size, encode, {}); };
    const std::uint64_t linear = bytes("linear") - 2 * sizeof(Vec4) * size.pixels();
    CHECK(bytes("exr") == linear + 3 * Film::bytes(size));
    CHECK(bytes("png") == linear + 20 * size.pixels());
    CHECK(bytes("raw") == linear + 8 * size.pixels());
}

TEST_CASE("a picture reserves its encoder's memory") {
    SmallDaemon daemon;
    const std::uint64_t before = daemon.budget.used();
    const auto taken = [&](const std::string& encode) {
        const JobSubmission picture = ask(daemon, 100, 100, encode);
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

TEST_CASE("a detached picture reserves its answer's largest size") {
    SmallDaemon daemon;
    const std::uint64_t raw = 100 * 100 * 4;
    for (const char* encode : {"raw", "png"}) {
        if (std::string(encode) == "png" && !images_available()) continue;
        const std::uint64_t reserved = ask(daemon, 100, 100, encode).result_bytes;
        CHECK(reserved >= raw);
        CHECK(reserved <= raw + image_header_bytes_max + 10'000);
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
    rgba.resize(std::size_t{64} * 48 * 4);  // without the padding
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

/// A picture of several rays per pixel, which no request can ask for yet.
class SampledPicture final : public PictureJob {
public:
    SampledPicture(const Services& services, const Caller& caller, PictureRequest asked)
        : PictureJob(services, caller, std::move(asked)),
          colours(request().pixels()) {}

    std::vector<Vec4> colours;

protected:
    [[nodiscard]] CastPlans plans() const override { return {&plan_}; }
    std::optional<CameraHits> trace_pixels(const PixelRange& pixels, const ColumnSource& scene,
                                           RayCaster& caster, const PixelArrays& arrays) override {
        std::vector<Vec4> values(pixels.count);
        const auto seen = render_primary(pixels, scene, caster, arrays, values);
        if (seen) place<Vec4>(pixels.first, values, colours.data());
        return seen;
    }
    Reply<Payload> encode() override { return Payload{1, 1, std::vector<std::byte>(1)}; }
};

TEST_CASE("a picture of several samples per pixel ends, and its edges are smooth") {
    // Chunks of 48 pixels of 5 rays, the last one is not full.
    protocol::Limits limits;
    limits.chunk_rays_max = 240;
    SmallDaemon daemon(limits);
    const Caller caller{{"me", 1}, 1, 1 << 20};
    const auto picture_of = [&](std::uint32_t samples) {
        wire::RenderT message;
        message.job = std::make_unique<wire::JobT>();
        message.job->scene = "forest";
        message.camera = from_above();
        const auto frame = protocol::encode(1, message, limits).value();
        const auto opened = protocol::open<wire::Render>(frame, limits).value();
        auto plan = make_plan(daemon.services, caller, job_words(*opened->job()), query_closest);
        REQUIRE(plan);
        REQUIRE(choose_backends(daemon.backends, 64 * 49, *plan));
        auto request =
            make_request(daemon.services, caller, std::move(*plan),
                         camera_request(opened->camera()), AskedPixels{{64, 49}}, "raw", 1000);
        REQUIRE(request);
        request->samples = samples;
        SampledPicture job(daemon.services, caller, std::move(*request));
        const StopFlag stop(Clock::time_point::max());
        while (std::optional<Task> task = job.next()) {
            REQUIRE(task->run(stop));
            REQUIRE(job.ended());
        }
        REQUIRE(job.finished());
        const Frames farewell = job.farewell();
        const auto done = protocol::open<wire::Done>(farewell.at(0), limits);
        REQUIRE(done);
        CHECK((*done)->rays() == std::uint64_t{64} * 49 * samples);
        CHECK((*done)->hits() + (*done)->misses() == (*done)->rays());
        return std::move(job.colours);
    };
    const std::vector<Vec4> once = picture_of(1);
    const std::vector<Vec4> often = picture_of(5);
    std::size_t between = 0;
    double difference = 0;
    for (std::size_t i = 0; i < once.size(); ++i) {
        CHECK((once[i].w == 0 || once[i].w == 1));
        CHECK((often[i].w >= 0 && often[i].w <= 1));
        between += often[i].w > 0 && often[i].w < 1 ? 1U : 0U;
        difference += static_cast<double>(std::abs(often[i].w - once[i].w));
    }
    CHECK(between > 20);
    CHECK(between < once.size() / 4);
    CHECK(difference < static_cast<double>(between));
}

TEST_CASE("an abandoned picture is not encoded") {
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
