// A third backend beside the others: whatever it does, every kind of job has the CPU's bytes.
#include "protocol/text.h"
#include "server/requests/request.h"
#include "tests/unit/server/bench.h"
#include "tests/unit/server/scripted_backend.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

using test::from_above;

using Does = ScriptedBackend::Does;
using Script = std::function<Does(std::uint64_t call)>;

constexpr std::uint64_t chunk_rays = 1000;

protocol::Limits small_chunks() {
    protocol::Limits limits;
    limits.chunk_rays_max = chunk_rays;
    return limits;
}

std::unique_ptr<wire::JobT> job_of(const std::string& worker) {
    auto job = std::make_unique<wire::JobT>();
    job->scene = "forest";
    job->worker = worker;
    return job;
}

/// A request and what its client sends after it.
struct Asked {
    protocol::Frame request;
    Frames input;
};

Asked ask_sent(const std::string& worker, const char* kind, std::uint64_t rays,
               std::uint64_t frame_rays, const char* reduce = "", std::uint32_t samples = 0,
               bool masked = false) {
    wire::QueryT query;
    query.job = job_of(worker);
    query.kind = kind;
    query.ray_count = rays;
    query.reduce = reduce;
    if (samples != 0) {
        query.generator = std::make_unique<wire::GeneratorT>();
        query.generator->kind = "hemisphere";
        query.generator->settings = {"samples=" + std::to_string(samples)};
    }
    Asked asked{protocol::encode(1, query).value(), {}};
    for (std::uint64_t first = 0; first < rays; first += frame_rays) {
        const std::uint64_t count = std::min(frame_rays, rays - first);
        protocol::Bulk bulk;
        bulk.add("rays", wire::Dtype::f32, 8, count);
        // A frame in three has no masks.
        if (masked && first / frame_rays % 3 != 2) bulk.add("masks", wire::Dtype::u32, 1, count);
        bulk.allocate();
        for (std::uint64_t i = 0; bulk.count() == 2 && i < count; ++i)
            bulk.block_as<std::uint32_t>(1)[i] = (first + i) % 5 < 2 ? 0U : ~0U << (first + i) % 3;
        const auto out = bulk.block_as<float>(0);
        for (std::uint64_t i = 0; i < count; ++i) {
            const auto n = static_cast<float>(first + i);
            const float ray[8] = {0.001F * n - 0.2F, 0.5F, 5, 0, 0, 0.0001F * n, -1, 1e30F};
            std::copy_n(ray, 8, out.begin() + static_cast<std::ptrdiff_t>(8 * i));
        }
        wire::QueryRaysT message;
        message.first_ray = first;
        asked.input.push_back(protocol::encode(1, std::move(message), std::move(bulk)).value());
    }
    return asked;
}

Asked ask_made(const std::string& worker, const char* kind, const char* reduce = "") {
    wire::QueryT query;
    query.job = job_of(worker);
    query.kind = kind;
    query.reduce = reduce;
    query.generator = std::make_unique<wire::GeneratorT>();
    query.generator->kind = "camera";
    query.generator->settings = {"size=61x83", "lookat=0.5,0.5,3,0.5,0.5,0"};
    return {protocol::encode(1, query).value(), {}};
}

template <class Picture>
Asked ask_picture(const std::string& worker, const char* count = nullptr) {
    Picture picture;
    picture.job = job_of(worker);
    picture.width = 61;
    picture.height = 83;
    picture.encode = "raw";
    picture.camera = from_above();
    if constexpr (requires { picture.count; })
        if (count != nullptr) picture.count = count;
    return {protocol::encode(1, picture).value(), {}};
}

struct Kind {
    const char* name;
    std::function<Asked(const std::string& worker)> ask;
};

const Kind kinds[] = {
    {"closest", [](auto worker) { return ask_sent(worker, "closest", 5000, 1000); }},
    {"any", [](auto worker) { return ask_sent(worker, "any", 5000, 1000); }},
    {"multi", [](auto worker) { return ask_sent(worker, "multi", 3000, 1000); }},
    {"all", [](auto worker) { return ask_sent(worker, "all", 3000, 1000); }},
    {"closest, masked",
     [](auto worker) { return ask_sent(worker, "closest", 5000, 1000, "", 0, true); }},
    {"any, masked", [](auto worker) { return ask_sent(worker, "any", 5000, 1000, "", 0, true); }},
    {"multi, masked",
     [](auto worker) { return ask_sent(worker, "multi", 3000, 1000, "", 0, true); }},
    {"all, masked", [](auto worker) { return ask_sent(worker, "all", 3000, 1000, "", 0, true); }},
    {"fraction, masked",
     [](auto worker) { return ask_sent(worker, "any", 7, 3, "hit_fraction", 2300, true); }},
    {"camera", [](auto worker) { return ask_made(worker, "closest"); }},
    {"camera, multi", [](auto worker) { return ask_made(worker, "multi"); }},
    {"fraction", [](auto worker) { return ask_sent(worker, "any", 7, 3, "hit_fraction", 2300); }},
    {"visible", [](auto worker) { return ask_made(worker, "closest", "visible_pixels"); }},
    {"render", [](auto worker) { return ask_picture<wire::RenderT>(worker); }},
    {"heatmap", [](auto worker) { return ask_picture<wire::HeatmapT>(worker); }},
    {"necessary heatmap",
     [](auto worker) { return ask_picture<wire::HeatmapT>(worker, "necessary"); }},
};

/// The answer that a client got.
struct Got {
    std::map<std::uint64_t, std::vector<std::byte>> answers;  ///< by their first row, or offset
    std::string worker;
    std::vector<std::string> notes;
    std::optional<Code> error;
    std::string message;
    bool operator==(const Got& other) const { return answers == other.answers; }
};

/// Jobs with threads, of the services of a daemon without any.
struct Served {
    explicit Served(Script script = {}, unsigned threads = 1, std::uint64_t call_rays = 3000) {
        if (script)
            put_first(daemon.backends,
                      std::make_unique<ScriptedBackend>(call_rays, threads, std::move(script)));
    }

    Reply<JobSubmission> submit(const protocol::Frame& request) {
        const Caller caller{{"me", 1}, request.header.request_id, Bench::window};
        auto answer = find_request(request.header.type)->answer(daemon.services, caller, request);
        if (!answer) return tl::unexpected(answer.error());
        return std::get<JobSubmission>(std::move(*answer));
    }

    Got get(Asked asked) {
        Got got;
        auto submission = submit(asked.request);
        if (!submission) {
            got.error = submission.error().code;
            got.message = submission.error().message;
            return got;
        }
        REQUIRE(bench.runner->start(1, std::move(*submission)));
        for (protocol::Frame& frame : asked.input) bench.runner->feed(std::move(frame));
        REQUIRE(bench.run_until_idle());
        for (const protocol::Frame& frame : bench.sent) {
            const std::vector<std::byte> bulk(frame.bulk.span().begin(), frame.bulk.span().end());
            if (const auto chunk = protocol::open<wire::Chunk>(frame)) {
                got.answers[(*chunk)->first_ray()] = bulk;
            } else if (const auto piece = protocol::open<wire::Payload>(frame)) {
                got.answers[(*piece)->offset()] = bulk;
            } else if (const auto done = protocol::open<wire::Done>(frame)) {
                got.worker = protocol::text((*done)->worker());
                got.notes = protocol::strings((*done)->notes());
            } else if (const auto error = protocol::open<wire::Error>(frame)) {
                got.error = static_cast<Code>((*error)->code());
                got.message = protocol::text((*error)->message());
            }
        }
        bench.sent.clear();
        return got;
    }

    test::SmallDaemon daemon{small_chunks()};
    Bench bench;
};

void check_same(const char* does, const Script& script, const std::string& worker,
                const std::string& note) {
    for (const Kind& kind : kinds) {
        INFO(std::string(does));
        INFO(std::string(kind.name));
        const Got expected = Served().get(kind.ask("cpu"));
        REQUIRE_FALSE(expected.error);
        REQUIRE(!expected.answers.empty());
        const Got got = Served(script).get(kind.ask("auto"));
        CHECK_MESSAGE(!got.error, got.message);
        CHECK(got == expected);
        CHECK(got.worker == worker);
        REQUIRE(got.notes.size() == (note.empty() ? 0 : 1));
        if (!note.empty()) CHECK(got.notes[0].find(note) != std::string::npos);
    }
}

TEST_CASE("a third backend gives every kind of job the CPU's bytes") {
    check_same(
        "answers", [](std::uint64_t) { return Does::answers; }, "scripted", "");
}

TEST_CASE("chunks that it refuses are dealt again, with the same bytes and a note") {
    check_same(
        "refuses all", [](std::uint64_t) { return Does::refuses; }, "cpu",
        "the scripted worker: it does not like these rays");
}

TEST_CASE("chunks that it answers late come with the same bytes") {
    check_same(
        "comes late",
        [](std::uint64_t call) { return call % 2 == 0 ? Does::comes_late : Does::answers; },
        "scripted", "");
}

TEST_CASE("when it dies the rest is the CPU's, with the same bytes") {
    check_same(
        "dies at once", [](std::uint64_t) { return Does::dies; }, "cpu",
        "the scripted worker: it died");
    // The same if it has answered a chunk before it dies.
    for (const Kind& kind : kinds) {
        INFO(std::string(kind.name));
        const Got expected = Served().get(kind.ask("cpu"));
        const Got got =
            Served([](std::uint64_t call) { return call == 1 ? Does::dies : Does::comes_late; }, 2,
                   1000)
                .get(kind.ask("auto"));
        CHECK_MESSAGE(!got.error, got.message);
        CHECK(got == expected);
    }
}

TEST_CASE("where it is demanded, what it refuses is an error") {
    Served served([](std::uint64_t call) { return call == 1 ? Does::dies : Does::answers; }, 1,
                  1000);
    const Got got = served.get(kinds[0].ask("scripted"));
    CHECK(got.error == Code::busy);
    CHECK(got.message.find("the scripted worker: it died") != std::string::npos);
    // From then on no job gets there.
    CHECK(served.get(kinds[0].ask("scripted")).error == Code::busy);
    CHECK(served.get(kinds[0].ask("auto")).worker == "cpu");
    const Got unknown = served.get(kinds[0].ask("tpu"));
    CHECK(unknown.message == "unknown worker 'tpu': use one of auto, cpu, cuda, scripted");
}

TEST_CASE("a list of variants tells what a backend has at one moment") {
    Served served([](std::uint64_t) { return Does::answers; });
    const protocol::Frame request = protocol::encode(1, wire::VariantsT{}).value();
    const auto named = [&] {
        std::vector<std::string> names;
        auto answer = find_request(request.header.type)
                          ->answer(served.daemon.services, {{"me", 1}, 1, Bench::window}, request);
        REQUIRE(answer);
        const Frames frames = std::get<Frames>(std::move(*answer));
        const auto list = protocol::open<wire::VariantList>(frames.front());
        REQUIRE(list);
        for (const wire::Variant* variant : protocol::present((*list)->variants()))
            if (std::ranges::count(protocol::strings(variant->targets()), "scripted") != 0)
                names.emplace_back(protocol::text(variant->name()));
        std::ranges::sort(names);
        return names;
    };
    CHECK(named().empty());
    CHECK(named() == std::vector<std::string>{"alpha_mask", "opaque"});
}

TEST_CASE("small requests that are traced together have the CPU's bytes") {
    std::atomic<std::uint64_t> calls{0};
    for (const Does does : {Does::answers, Does::refuses, Does::dies}) {
        std::vector<Got> got(2);
        for (const bool scripted : {false, true}) {
            const Script script = [&calls, does](std::uint64_t) {
                ++calls;
                return does;
            };
            Served served(scripted ? script : Script(), 0, 1000);
            for (std::uint64_t id = 1; id <= 4; ++id) {
                Asked asked = ask_sent("auto", "closest", 100, 100);
                asked.request.header.request_id = id;
                asked.input[0].header.request_id = id;
                REQUIRE(served.bench.runner->start(id, std::move(*served.submit(asked.request))));
                served.bench.runner->feed(std::move(asked.input[0]));
            }
            REQUIRE(served.bench.run_until_idle());
            CHECK(served.bench.count(wire::Message::Done) == 4);
            for (const protocol::Frame& frame : served.bench.sent)
                if (protocol::open<wire::Chunk>(frame))
                    got[scripted ? 1 : 0].answers[frame.header.request_id] = {
                        frame.bulk.span().begin(), frame.bulk.span().end()};
            // Those that are dealt again may meet again.
            if (!scripted || does == Does::answers)
                CHECK(served.bench.metrics.tasks_coalesced == 4);
        }
        CHECK(got[0].answers.size() == 4);
        CHECK(got[0] == got[1]);
    }
    CHECK(calls != 0);
}

}  // namespace
}  // namespace raynest::server
