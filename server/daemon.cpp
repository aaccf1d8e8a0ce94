#include "server/daemon.h"

#include "engine/packs/load.h"
#include "protocol/text.h"
#include "server/diag/exposition.h"
#include "server/diag/line_limit.h"
#include "server/execution/fair_thread_pool.h"
#include "server/execution/trace.h"
#include "server/handlers/handler.h"
#include "server/import_command.h"
#include "server/jobs/admission.h"
#include "server/jobs/detached.h"
#include "server/jobs/runner.h"
#include "server/log.h"
#include "server/notify.h"
#include "server/net/asio.h"
#include "server/net/connections.h"
#include "server/net/http.h"
#include "server/net/inherited.h"
#include "server/net/listener.h"
#include "server/net/page_access.h"
#include "server/net/transports.h"
#include "server/ready_file.h"
#include "server/start_checks.h"
#include "server/store/scene_store.h"

#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Maximum spare threads, for tasks that wait while long ones occupy all threads. Three requests
/// have at most 3 * (threads + 1) chunks in flight; that leaves 13 threads for other tasks.
constexpr unsigned spare_threads(unsigned threads) {
    return 2 * threads + 16;
}
/// Maximum concurrent imports; each is a process with limits of its own.
constexpr unsigned imports_max = 2;
constexpr std::chrono::milliseconds drain_look{20};
/// Interval of the search for connections whose client's machine or network is gone.
constexpr std::chrono::seconds lost_look{5};
/// Interval of looking at the token file: a revoked token ends its connections within a second.
constexpr std::chrono::milliseconds tokens_look{300};
/// Time for clients to receive the error after a drain took too long.
constexpr std::chrono::milliseconds last_words_time{1000};
constexpr int exit_forced = 3;
/// Time beyond chunk_ms_max after which the task of a compute thread counts as stuck.
constexpr std::chrono::milliseconds stuck_grace{5000};

class Daemon final : public Administration {
public:
    Daemon(Options options, ReadOptions read_again, std::shared_ptr<const Registry> registry);

    Result<void> listen();
    /// Opens the HTTP port. Fails if the address was given by option; else the daemon has none.
    Result<void> listen_http();
    /// Returns http://HOST:PORT, https://HOST:PORT or "off".
    [[nodiscard]] std::string http_uri() const { return http_listener_ ? http_listener_->uri() : "off"; }
    /// Serves until drained. Fails when the ready file cannot be written.
    Result<void> run();

    [[nodiscard]] std::vector<ConnectionRow> connections(std::uint64_t after) const override {
        return connections_.rows(after);
    }
    /// Begins after the administrator has its answer.
    void drain() override {
        asio::post(io_, [this] { begin_to_drain(); });
    }
    Reply<std::string> reload() override;
    std::size_t kick(std::uint64_t connection, const std::string& principal) override;
    [[nodiscard]] bool knows(const std::string& principal) override;
    void set_quota(const std::string& principal, const Quota& quota) override;

private:
    void serve_health();
    void await_signal();
    void begin_to_drain();
    void look_drained();
    void look_after_detached();
    void look_for_lost();
    void look_at_tokens();
    void end_revoked();
    void feed_watchdog(std::chrono::microseconds interval);
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
    SceneStore scenes_;
    Admission admission_;
    TraceBufferPool trace_buffers_;
    InlineBudget inline_budget_;
    Coalescer coalescer_;
    asio::io_context io_{1};
    Services services_;
    JobContext context_;
    DetachedJobs detached_;
    // Keep the threads below all members that tasks use: destruction joins the threads first.
    Backends backends_;
    FairThreadPool compute_;
    FairThreadPool blocking_;
    asio::signal_set signals_;
    asio::steady_timer drain_timer_;
    asio::steady_timer detached_timer_;
    asio::steady_timer lost_timer_;
    asio::steady_timer tokens_timer_;
    asio::steady_timer watchdog_timer_;
    Credentials credentials_;
    Connections connections_;
    InheritedSockets inherited_;
    std::vector<std::unique_ptr<Listener>> listeners_;
    PageAccess page_access_;
    HttpSite site_;
    HttpServer http_;
    std::unique_ptr<Listener> http_listener_;  ///< null: no HTTP port
    Clock::time_point drain_deadline_ = Clock::time_point::max();
    bool serving_ = false;    ///< connections are accepted
    bool cut_short_ = false;  ///< the drain exceeded its deadline
};

Daemon::Daemon(Options options, ReadOptions read_again, std::shared_ptr<const Registry> registry)
    : options_(std::move(options)),
      read_again_(std::move(read_again)),
      registry_(std::move(registry)),
      limits_(options_.limits),
      budget_(options_.memory),
      peers_(limits_, budget_, metrics_),
      scenes_(budget_, limits_),
      admission_(limits_),
      trace_buffers_(budget_),
      services_{*registry_,
                scenes_,
                budget_,
                metrics_,
                limits_,
                ImportLimits{},
                options_.scene_root,
                import_command(options_.target, options_.pack_dirs),
                admission_,
                detached_,
                peers_,
                backends_,
                trace_buffers_,
                blocking_,
                {},
                this},
      context_{compute_,
               admission_,
               metrics_,
               limits_,
               [this](std::function<void()> done) { asio::post(io_, std::move(done)); },
               budget_,
               inline_budget_,
               coalescer_,
               peers_},
      detached_(context_, [this] { look_after_detached(); }),
      backends_(make_backends({options_, *registry_, budget_, metrics_, limits_})),
      compute_(options_.threads, FairThreadPool::Time::processor, spare_threads(options_.threads)),
      blocking_(imports_max, FairThreadPool::Time::clock),
      signals_(io_, SIGTERM, SIGINT, SIGHUP),
      drain_timer_(io_),
      detached_timer_(io_),
      lost_timer_(io_),
      tokens_timer_(io_),
      watchdog_timer_(io_),
      credentials_(options_.security, limits_),
      connections_(io_, services_, context_,
                   [this](const PeerIdentity& peer, const wire::Hello& hello,
                          const protocol::Limits&) {
                       return credentials_.authentication().identify(
                           peer, protocol::text(hello.token()), Clock::now(), WallClock::now());
                   }),
      page_access_(credentials_.authentication(), [this] { end_revoked(); }),
      site_(options_.http.hosts),
      http_(io_, site_, connections_, services_) {}

Result<void> Daemon::listen() {
    if (const auto loaded = credentials_.load(); !loaded) return loaded;
    for (const std::string& uri : options_.listen) {
        auto address = parse_address(uri);
        if (!address) return tl::unexpected(address.error());
        inherited_.claim(*address);
        const MakeTransport make = find_scheme(scheme_of(*address))->make;
        auto listener =
            Listener::open(io_, *address, "--listen", options_.socket,
                           [this, make](Socket socket, Listener::Descriptors descriptors) {
                               connections_.accept(make(std::move(socket), {credentials_.tls()}),
                                                   descriptors);
                           });
        if (!listener) return tl::unexpected(listener.error());
        listeners_.push_back(std::move(*listener));
    }
    if (options_.http.address != "off")
        if (const auto listening = listen_http(); !listening) return listening;
    inherited_.warn_of_unclaimed();
    return {};
}

Result<void> Daemon::listen_http() {
    auto address = parse_http_address(options_.http.address);
    if (!address) return tl::unexpected(address.error());
    inherited_.claim(*address);
    const bool is_encrypted = scheme_of(*address) == "https";
    auto listener =
        Listener::open(io_, *address, "--http", options_.socket,
                       [this, is_encrypted](Socket socket, Listener::Descriptors descriptors) {
                           http_.accept(std::move(socket), descriptors,
                                        is_encrypted ? credentials_.tls().get() : nullptr);
                       });
    if (!listener && options_.http.given) return tl::unexpected(listener.error());
    if (!listener) {
        log(LogLevel::warn, "http_off", {{"reason", listener.error().message}});
        return {};
    }
    http_listener_ = std::move(*listener);
    site_.set_address(std::get<TcpAddress>(http_listener_->address()));
    site_.set_access(page_access_);
    services_.page_logins = &credentials_.authentication().logins();
    serve_health();
    return {};
}

void Daemon::serve_health() {
    site_.set_metrics([this] {
        return exposition(services_, credentials_.certificate_days_left(WallClock::now()));
    });
    site_.set_unready([this]() -> std::string {
        if (!serving_) return "the daemon is starting";
        const auto most = std::chrono::milliseconds(limits_.chunk_ms_max) + stuck_grace;
        if (compute_.longest_task() <= most) return {};
        return "a worker thread is stuck: its task has run for more than " +
               std::to_string(most.count()) + " ms";
    });
}

Result<void> Daemon::run() {
    log(LogLevel::info, "started",
        {{"version", RAYNEST_VERSION},
         {"pid", std::to_string(getpid())},
         {"threads", std::to_string(options_.threads)},
         {"memory", protocol::bytes_text(options_.memory)},
         {"target", registry_->variants().front().target}});
    std::vector<std::string> uris;
    for (const auto& listener : listeners_) {
        listener->start();
        uris.push_back(listener->uri());
        log(LogLevel::info, "listening", {{"uri", listener->uri()}});
    }
    if (http_listener_) {
        services_.page = http_uri();
        http_listener_->start();
        const std::string uri = http_uri();
        log(LogLevel::info, "http",
            {{"page", uri},
             {"hint", is_beyond_loopback(http_listener_->address())
                          ? "raynest open shows it"
                          : "from another machine, forward the port: ssh -L 31061:" +
                                uri.substr(uri.find("//") + 2) + " HOST"}});
    }
    await_signal();
    look_for_lost();
    look_at_tokens();
    serving_ = true;
    if (!options_.ready_file.empty()) {
        // Fail without the file: programs that wait for it would wait for ever.
        if (const auto written = write_ready_file(options_.ready_file, uris, http_uri()); !written)
            return tl::unexpected(written.error());
    }
    notify("READY=1");
    if (const auto interval = watchdog_interval()) feed_watchdog(*interval);
    for (;;) {
        try {
            io_.run();
            break;
        } catch (const std::exception& error) {
            // Log and go on: the exception comes from a handler outside the connections'
            // coroutines, and only that handler's work is lost.
            log(LogLevel::error, "handler_failed", {{"reason", error.what()}});
        }
    }
    remove_own_files();
    log(LogLevel::info, "stopped");
    return {};
}

void Daemon::end_at_once() {
    remove_own_files();
    std::_Exit(exit_forced);
}

void Daemon::await_signal() {
    signals_.async_wait([this](const SystemError& error, int signal) {
        if (error) return;
        if (signal == SIGHUP) {
            (void)reload();
            return await_signal();
        }
        const bool draining = drain_deadline_ != Clock::time_point::max();
        if (draining) {
            log(LogLevel::warn, "stopping_at_once");
            end_at_once();
        }
        begin_to_drain();
        await_signal();
    });
}

void Daemon::begin_to_drain() {
    if (drain_deadline_ != Clock::time_point::max()) return;
    log(LogLevel::info, "draining", {{"connections", std::to_string(connections_.size())}});
    notify("STOPPING=1");
    drain_deadline_ = Clock::now() + std::chrono::milliseconds(limits_.drain_ms_max);
    for (const auto& listener : listeners_) listener->close();
    connections_.drain();
    // The HTTP port stays open until the end: /readyz tells that the daemon drains.
    site_.drain();
    look_drained();
}

void Daemon::look_drained() {
    peers_.dismiss();
    // Ends connections that had time to fetch an answer.
    connections_.drain();
    // Count jobs of closed connections too: their tasks still use members of the daemon.
    const bool drained = connections_.empty() && admission_.active() == 0;
    if (drained && !cut_short_) return io_.stop();
    const bool late = Clock::now() >= drain_deadline_;
    if (drained || (late && cut_short_)) end_at_once();
    if (late) {
        log(LogLevel::warn, "drain_took_too_long", {{"jobs", std::to_string(admission_.active())}});
        cut_short_ = true;
        drain_deadline_ = Clock::now() + last_words_time;
        detached_.stop_running();
        connections_.close_with_error(
            {Code::draining, "the daemon is shutting down: start this again when it is back", 0});
    }
    drain_timer_.expires_after(drain_look);
    drain_timer_.async_wait([this](const SystemError& error) {
        if (!error) look_drained();
    });
}

// Enforces the time limits of detached jobs; a connection's watchdog does so for its own jobs.
void Daemon::look_after_detached() {
    const Clock::time_point next = detached_.next_tick();
    if (next == Clock::time_point::max()) return;
    detached_timer_.expires_at(next);
    detached_timer_.async_wait([this](const SystemError& error) {
        if (error) return;
        detached_.tick(Clock::now());
        look_after_detached();
    });
}

void Daemon::look_for_lost() {
    lost_timer_.expires_after(lost_look);
    lost_timer_.async_wait([this](const SystemError& error) {
        if (error) return;
        connections_.close_lost();
        trace_buffers_.trim();
        log_left_out_handshakes();
        page_access_.look_at_logins();
        look_for_lost();
    });
}

void Daemon::look_at_tokens() {
    if (options_.security.tokens.empty()) return;
    tokens_timer_.expires_after(tokens_look);
    tokens_timer_.async_wait([this](const SystemError& error) {
        if (error) return;
        if (credentials_.look_at_tokens(WallClock::now())) end_revoked();
        look_at_tokens();
    });
}

// The io thread proves that it still handles events; jobs run on other threads.
void Daemon::feed_watchdog(std::chrono::microseconds interval) {
    notify("WATCHDOG=1");
    watchdog_timer_.expires_after(interval);
    watchdog_timer_.async_wait([this, interval](const SystemError& error) {
        if (!error) feed_watchdog(interval);
    });
}

void Daemon::end_revoked() {
    const auto now = WallClock::now();
    connections_.close_unless(
        [&](const Principal& principal) {
            return credentials_.authentication().still_valid(principal, now);
        },
        {Code::not_allowed,
         "the token or login of this connection was revoked, has expired or has changed", 0});
}

Reply<std::string> Daemon::reload() {
    notify("RELOADING=1");
    std::string fault;
    Reload changes;
    if (read_again_) {
        if (auto then = read_again_()) {
            changes = apply_changes(options_, *then);
            apply_options();
        } else {
            fault = then.error().message;
            log(LogLevel::error, "configuration_unusable", {{"reason", fault}, {"kept", "old"}});
        }
    }
    const auto credentials = credentials_.reload(options_.security);
    if (!credentials && fault.empty()) fault = credentials.error().message;
    end_revoked();
    notify("READY=1");
    if (!changes.needs_restart.empty())
        log(LogLevel::warn, "restart_needed", {{"options", changes.needs_restart}});
    const std::string read = "configuration, certificates and tokens were read again";
    log(fault.empty() ? LogLevel::info : LogLevel::error, "reloaded",
        {{"result", fault.empty() ? read : "some files were unusable and their old content stays"},
         {"changed", changes.changed}});
    if (fault.empty()) return read;
    return refuse(Code::file_unusable, without_folders(fault) + "; the old content stays");
}

void Daemon::apply_options() {
    set_log_level(options_.log_level);
    set_log_format(options_.log_format);
    site_.set_names(options_.http.hosts);
    // Write only what differs: compute threads read the limits that never do.
    for (const protocol::LimitInfo& limit : protocol::limit_table())
        if (auto& value = limits_.*limit.value; value != options_.limits.*limit.value)
            value = options_.limits.*limit.value;
    admission_.set_limits(limits_);
    scenes_.set_limits(limits_);
}

std::size_t Daemon::kick(std::uint64_t connection, const std::string& principal) {
    return connections_.kick(connection, principal,
                             {Code::not_allowed, "an administrator has ended this connection", 0});
}

bool Daemon::knows(const std::string& principal) {
    return peers_.size_of(principal) != 0 || admission_.active_of(principal) != 0 ||
           scenes_.charged_to(principal, true).scenes != 0 ||
           credentials_.authentication().tokens().find_name(principal) != nullptr;
}

void Daemon::set_quota(const std::string& principal, const Quota& quota) {
    admission_.quotas().set(principal, quota);
    scenes_.quotas().set(principal, quota);
}

int failed(const Error& error) {
    std::fprintf(stderr, "raynestd: %s\n", error.message.c_str());
    return 1;
}

}  // namespace

int run_daemon(Options options, ReadOptions read_again) {
    (void)std::signal(SIGPIPE, SIG_IGN);
    if (const auto enough = raise_descriptor_limit(); !enough) return failed(enough.error());
    // Check the ready file before anything listens: another program's file ends the start.
    if (!options.ready_file.empty())
        if (const auto free = check_ready_file(options.ready_file); !free)
            return failed(free.error());
    StateLock lock;
    if (!options.state.empty()) {
        auto taken = StateLock::take(options.state);
        if (!taken) return failed(taken.error());
        lock = std::move(*taken);
    }
    const auto registry = Registry::load({options.pack_dirs, options.target});
    if (!registry) return failed(registry.error());
    warn_of_useless(options);
    Daemon daemon(std::move(options), std::move(read_again), *registry);
    if (const auto listening = daemon.listen(); !listening) return failed(listening.error());
    if (const auto ended = daemon.run(); !ended) return failed(ended.error());
    return 0;
}

}  // namespace raynest::server
