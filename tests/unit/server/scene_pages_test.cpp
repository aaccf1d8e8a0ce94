// SCENES and UNLOAD of many scenes: every page fits a message, however long the names are.
#include "server/ground/log.h"
#include "server/requests/request.h"
#include "server/store/scene_store.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <string>
#include <vector>

namespace raynest::server {
namespace {

using test::SmallDaemon;

constexpr int count = 300;

/// A store with many names of maximal length, of a principal with the longest existing name.
struct Crowded {
    Crowded() {
        set_log_level(LogLevel::error);
        caller.principal = std::string(45, '1');
        caller.connection = daemon.scenes.connect();
        caller.request_id = 1;
        const auto scene = test::build_scene(test::tree_scene());
        for (int i = 0; i < count; ++i) {
            const std::string number = std::to_string(1000 + i);
            const std::string name = number + std::string(daemon.limits.name_bytes_max - 4, 'n');
            REQUIRE(scenes.publish(name, scene, {}, caller));
        }
    }

    /// Returns a handler's answer, opened as a client opens it.
    template <class Table, class Ask, class Native>
    protocol::Frame ask(Ask handler, const Native& message) {
        const auto frame = protocol::encode(1, message, daemon.limits).value();
        auto answer = handler(services, caller, *protocol::open<Table>(frame, daemon.limits));
        REQUIRE_MESSAGE(answer, (answer ? "" : answer.error().message));
        return std::move(std::get<Frames>(*answer).front());
    }

    SmallDaemon daemon;
    protocol::Limits many = [] {
        protocol::Limits limits;
        limits.principal_scenes_max = 2 * count;
        return limits;
    }();
    SceneStore scenes{daemon.budget, many};
    Services services{daemon.services.registry,
                      scenes,
                      daemon.budget,
                      daemon.metrics,
                      daemon.limits,
                      {},
                      {},
                      {},
                      daemon.admission,
                      daemon.detached,
                      daemon.peers,
                      daemon.backends,
                      daemon.trace_buffers,
                      daemon.blocking};
    Caller caller;
};

TEST_CASE("a page of scenes with the longest names fits a message") {
    Crowded crowded;
    wire::ScenesT request;
    int pages = 0;
    while (request.first < count) {
        const auto frame = crowded.ask<wire::Scenes>(&scenes, request);
        const auto list = protocol::open<wire::SceneList>(frame, crowded.daemon.limits);
        REQUIRE_MESSAGE(list, (list ? "" : list.error().message));
        const std::vector<std::string> names = protocol::strings((*list)->names());
        CHECK((*list)->total() == count);
        REQUIRE(!names.empty());
        CHECK(names[0].starts_with(std::to_string(1000 + request.first)));
        CHECK(protocol::strings((*list)->owners())[0] == crowded.caller.principal);
        CHECK(protocol::present((*list)->holders()).Get(0) == 1);
        request.first += static_cast<std::uint32_t>(names.size());
        ++pages;
    }
    CHECK(pages == 3);
}

TEST_CASE("all scenes are unloaded page by page, until there are none") {
    Crowded crowded;
    wire::UnloadT request;
    request.all = true;
    std::size_t unloaded = 0;
    while (true) {
        const auto frame = crowded.ask<wire::Unload>(&unload, request);
        const auto page = protocol::open<wire::Unloaded>(frame, crowded.daemon.limits);
        REQUIRE(page);
        const std::size_t more = protocol::strings((*page)->names()).size();
        if (more == 0) break;
        unloaded += more;
    }
    CHECK(unloaded == count);
    CHECK(crowded.scenes.size() == 0);
}

}  // namespace
}  // namespace raynest::server
