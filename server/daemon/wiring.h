// The parts of the daemon: what it is made of, and in which order they end. daemon.cpp starts, serves
// and stops; administration.cpp has what administrators and reloads change.
#pragma once

#include "server/backends/backends.h"
#include "server/daemon/daemon.h"
#include "server/daemon/handover.h"
#include "server/daemon/start_loads.h"
#include "server/execution/kept_selections.h"
#include "server/execution/trace.h"
#include "server/http/page_access.h"
#include "server/http/server.h"
#include "server/jobs/scene_poser.h"
#include "server/jobs/scene_waker.h"
#include "server/net/asio.h"
#include "server/net/inherited.h"
#include "server/net/listener.h"
#include "server/options/listen_policy.h"
#include "server/requests/request.h"
#include "server/scheduling/admission.h"
#include "server/scheduling/detached.h"
#include "server/scheduling/fair_thread_pool.h"
#include "server/scheduling/runner.h"
#include "server/sessions/connections.h"
#include "server/store/scene_store.h"
#include "server/store/state_folder.h"

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

/// Io thread only, once it runs.
class Daemon final : public Administration {
public:
    Daemon(Options options, ReadOptions read_again, std::shared_ptr<const Registry> registry,
           std::unique_ptr<StateFolder> state);
    ~Daemon() {
        // No job runs any more, so no other thread drops a scene.
        scenes_.set_disposal({});
        detached_.clear();
    }

    /// Takes the sockets of a daemon that gives way, which learns when this one serves.
    void follow(Predecessor predecessor);
    /// Opens the addresses, and the socket for a successor in the state folder, whose lock this is.
    Result<void> listen(const StateLock& lock);
    /// Opens the HTTP port. Fails if the address was given by option; else the daemon has none.
    Result<void> listen_http();
    /// Returns http://HOST:PORT, https://HOST:PORT or "off".
    std::string http_uri() const { return http_listener_ ? http_listener_->uri() : "off"; }
    /// Serves until drained. Fails when the ready file cannot be written.
    Result<void> run();

    [[nodiscard]] std::vector<ConnectionRow> connections(std::uint64_t after) const override {
        return connections_.rows(after);
    }
    /// Begins after the administrator has its answer.
    void drain() override {
        asio::post(io_, [this] { begin_to_drain(); });
    }
    std::function<Take()> reload() override;
    std::size_t kick(std::uint64_t connection, const std::string& principal) override;
    [[nodiscard]] bool knows(const std::string& principal) override;
    void set_quota(const std::string& principal, const Quota& quota) override;

private:
    void serve_health();
    void await_signal();
    /// Takes no more work. A successor, if there is one, has the sockets.
    void begin_to_drain(bool has_successor = false);
    void look_drained();
    [[nodiscard]] std::vector<HandedSocket> handed_sockets();
    /// Serves in place of the daemon before, whose sockets become those that the options name.
    void take_place();
    void look_after_detached();
    /// Does something again and again, with this pause before each time.
    void repeat(asio::steady_timer& timer, std::chrono::microseconds pause,
                std::function<void()> act);
    /// Ends connections and detached jobs of principals that would not be admitted again, and every
    /// WebSocket if hosts or proxies of the page were taken away: its next request is judged anew.
    void end_revoked(bool is_site_smaller = false);
    /// Does `work` on a compute thread, and what it returns on the io thread.
    void elsewhere(std::function<std::function<void()>()> work);
    void look_at_credentials();
    void apply_options();
    void remove_own_files() {
        if (!options_.ready_file.empty()) remove_ready_file(options_.ready_file);
    }
    [[noreturn]] void end_at_once();

    Options options_;
    const ReadOptions read_again_;  ///< empty in programs without a command line
    const std::shared_ptr<const Registry> registry_;
    protocol::Limits limits_;
    Metrics metrics_;
    Budget budget_;
    Peers peers_;
    std::optional<Predecessor> predecessor_;    ///< goes on if the start fails: outlives state_
    const std::unique_ptr<StateFolder> state_;  ///< null: no --state
    SceneStore scenes_;
    Admission admission_;
    TraceBufferPool trace_buffers_;
    InlineBudget inline_budget_;
    Coalescer coalescer_;
    asio::io_context io_{1};
    Services services_;
    SceneWaker waker_;
    ScenePoser poser_;
    KeptSelections selections_;
    JobContext context_;
    DetachedJobs detached_;
    // Keep the threads below all members that tasks use: destruction joins the threads first.
    Backends backends_;
    FairThreadPool compute_;
    FairThreadPool blocking_;
    FairThreadPool disk_;
    asio::signal_set signals_;
    asio::steady_timer drain_timer_;
    asio::steady_timer detached_timer_;
    asio::steady_timer lost_timer_;
    asio::steady_timer credentials_timer_;
    asio::steady_timer watchdog_timer_;
    Credentials credentials_;
    std::weak_ptr<const int> tokens_reading_;  ///< while the token file is read again
    Connections connections_;
    InheritedSockets inherited_;
    std::vector<std::unique_ptr<Listener>> listeners_;
    std::vector<ListenAddress> open_;  ///< what the daemon listens on, the HTTP port included
    PageAccess page_access_;
    HttpSite site_;
    HttpServer http_;
    StartLoads start_loads_;
    std::unique_ptr<Listener> http_listener_;  ///< null: no HTTP port
    Handover handover_;
    Clock::time_point drain_deadline_ = Clock::time_point::max();
    std::string why_draining_;  ///< what clients are told; empty: the usual
    std::uint64_t reloads_begun_ = 0;
    std::uint64_t reload_taken_ = 0;  ///< the number of the latest one
    bool serving_ = false;            ///< connections are accepted
    bool cut_short_ = false;          ///< the drain exceeded its deadline
};

}  // namespace raynest::server
