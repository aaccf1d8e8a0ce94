// A daemon without sockets and threads: `sent` holds its frames, and its tasks run one at a time
// when the test calls step(). Equal frames give equal steps.
#pragma once

#include "server/backends/backends.h"
#include "server/execution/trace.h"
#include "server/options/options.h"
#include "server/sessions/conversation.h"
#include "server/store/scene_store.h"
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
    explicit SmallDaemon(const protocol::Limits& within = {}, std::uint64_t memory = 1 << 26)
        : limits(within),
          budget(memory) {
        // The scene that the examples use; another owner holds it, so that none of them can unload
        // it.
        SceneDescription forest = tree_scene();
        forest.cameras.resize(1);
        forest.cameras[0].name = "overview";
        scenes
            .publish("forest", build_scene(forest), {.share = {"public"}},
                     {"owner", scenes.connect()})
            .value();
    }

    void send(protocol::Frame frame) override { sent.push_back(std::move(frame)); }
    [[nodiscard]] std::uint64_t backlog() const override { return waiting; }

    /// Bytes of --memory in use, but for buffers that wait for the next chunk.
    [[nodiscard]] std::uint64_t used_bytes() {
        for (int i = 0; i < 2; ++i) (void)trace_buffers.trim();
        return budget.used();
    }

    /// Hands one completion to the io side, or runs one task; false when neither waits.
    bool step() {
        if (posted.empty()) return compute.run_one() || blocking.run_one();
        const std::function<void()> next = std::move(posted.front());
        posted.pop_front();
        try {
            next();
        } catch (const std::exception&) {
            ++handlers_failed;  // the daemon's own loop continues, too
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
    server::Budget budget;
    server::Peers peers{limits, budget, metrics};
    server::SceneStore scenes{budget, {}, [] { return server::SceneStore::Clock::time_point(); }};
    server::Admission admission{limits};
    server::InlineBudget inline_budget;
    server::Coalescer coalescer;
    std::uint64_t waiting = 0;  ///< the result of backlog()
    std::size_t handlers_failed = 0;
    std::vector<protocol::Frame> sent;
    std::deque<std::function<void()>> posted;
    server::TraceBufferPool trace_buffers{budget};
    server::Backends backends = server::make_backends({"", *registry, budget, metrics, limits});
    server::FairThreadPool compute{0};
    server::FairThreadPool blocking{0};
    server::Services services{*registry, scenes,   budget, metrics,  limits,        {},      {}, {},
                              admission, detached, peers,  backends, trace_buffers, blocking};
    server::JobContext engine{
        compute,
        admission,
        metrics,
        limits,
        [this](std::function<void()> done) { posted.push_back(std::move(done)); },
        budget,
        inline_budget,
        coalescer,
        peers};
    server::DetachedJobs detached{engine, [] {}};
};

/// A conversation of one client of that daemon.
class Client final : public server::Conversation {
public:
    explicit Client(SmallDaemon& daemon, std::string principal = "me",
                    server::Role role = server::Role::user)
        : Conversation(daemon.services, daemon.engine, daemon, "nobody",
                       [principal, role](const wire::Hello&) -> server::Reply<server::Principal> {
                           return server::Principal{principal, {}, role};
                       }) {}
};

template <class Native>
protocol::Frame frame_of(std::uint64_t id, const Native& message) {
    return protocol::encode(id, message).value();
}

/// Returns the codes of all error answers, in order.
inline std::vector<server::Code> errors_of(const SmallDaemon& daemon) {
    std::vector<server::Code> codes;
    for (const protocol::Frame& frame : daemon.sent)
        if (const auto error = protocol::open<wire::Error>(frame))
            codes.push_back(static_cast<server::Code>((*error)->code()));
    return codes;
}

/// Zeros as a piece of request 1's upload.
inline protocol::Frame piece_of(std::uint64_t bytes) {
    protocol::Bulk bulk;
    bulk.add("data", wire::Dtype::u8, 1, bytes);
    bulk.allocate();
    std::fill_n(bulk.block(0).data(), bytes, std::byte{0});
    return protocol::encode(1, wire::UploadT{}, std::move(bulk)).value();
}

/// A camera above a square, which does not fill the picture.
inline std::unique_ptr<wire::CameraT> from_above() {
    auto camera = std::make_unique<wire::CameraT>();
    camera->look_at = true;
    camera->eye = std::make_unique<wire::Vec3>(0.5F, 0.5F, 3.0F);
    camera->at = std::make_unique<wire::Vec3>(0.5F, 0.5F, 0.0F);
    camera->up = std::make_unique<wire::Vec3>(0.0F, 1.0F, 0.0F);
    return camera;
}

}  // namespace raynest::test
