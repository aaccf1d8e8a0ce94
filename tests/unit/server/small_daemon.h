// A daemon without sockets and threads: what it says lies in `sent`, and its tasks run when the
// test says so, one at a time. The same frames give the same steps.
#pragma once

#include "server/conversation.h"
#include "tests/unit/engine/small_scenes.h"

#include <algorithm>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace raynest::test {

class SmallDaemon final : public server::Sink {
public:
    explicit SmallDaemon(const protocol::Limits& within = {}) : limits(within) {
        // What the examples ask about; of another owner, so that none can unload it.
        SceneDescription forest = tree_scene();
        forest.cameras.resize(1);
        forest.cameras[0].name = "overview";
        scenes.publish("forest", bake(forest), {}, {"owner", scenes.connect()}).value();
    }

    void send(protocol::Frame frame) override { sent.push_back(std::move(frame)); }
    [[nodiscard]] std::uint64_t backlog() const override { return waiting; }

    /// Hands one completion to the io side, or runs one task; false when neither waits.
    bool step() {
        if (posted.empty()) return compute.run_one() || blocking.run_one();
        const std::function<void()> next = std::move(posted.front());
        posted.pop_front();
        try {
            next();
        } catch (const std::exception&) {
            ++handlers_failed;  // as the daemon's own loop, which goes on
        }
        return true;
    }
    void settle() {
        while (step()) {
        }
    }
    [[nodiscard]] bool said(wire::Message type) const {
        return std::any_of(sent.begin(), sent.end(), [&](const protocol::Frame& frame) {
            return frame.header.type == static_cast<std::uint16_t>(type);
        });
    }

    const protocol::Limits limits;
    const std::shared_ptr<const Registry> registry = Registry::load({}).value();
    server::Metrics metrics;
    server::Budget budget{1 << 26};
    server::Peers peers{limits, budget, metrics};
    server::SceneStore scenes{budget, {}, [] { return server::SceneStore::Clock::time_point(); }};
    server::Admission admission{limits};
    server::BriefTurn brief_turn;
    server::Coalescer coalescer;
    std::uint64_t waiting = 0;  ///< what backlog() says
    std::size_t handlers_failed = 0;
    std::vector<protocol::Frame> sent;
    std::deque<std::function<void()>> posted;
    server::Services services{*registry, scenes, budget,    metrics,  limits, {},
                              {},        {},     admission, detached, peers,  nullptr};
    server::Workers compute{0};
    server::Workers blocking{0};
    server::Workers device{0};
    server::Engine engine{compute,
                          blocking,
                          device,
                          admission,
                          metrics,
                          limits,
                          [this](std::function<void()> done) { posted.push_back(std::move(done)); },
                          budget,
                          brief_turn,
                          coalescer,
                          peers};
    server::DetachedJobs detached{engine, [] {}};
};

}  // namespace raynest::test
