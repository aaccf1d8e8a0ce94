#include "server/daemon/daemon.h"

#include "protocol/text.h"
#include "server/daemon/constants.h"
#include "server/daemon/exposition.h"
#include "server/daemon/import_command.h"
#include "server/daemon/notify.h"
#include "server/daemon/wiring.h"
#include "server/ground/io_turn.h"
#include "server/ground/journal.h"
#include "server/ground/limited_log.h"
#include "server/ground/log.h"
#include "server/net/transports.h"
#include "server/options/limits_in_force.h"
#include "server/options/ready_file.h"
#include "server/options/reload.h"
#include "server/options/start_checks.h"
#include "server/scheduling/disposal.h"

#include <fcntl.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Time beyond chunk_ms_max after which the task of a compute thread counts as stuck.
constexpr std::chrono::milliseconds stuck_grace{5000};

/// Returns why a daemon that lives takes no work, for /readyz: scenes are being loaded, file
/// descriptors are short, or a thread of `compute` is stuck. Empty if there is no reason.
std::string unready_reason(const StartLoads& loads, FairThreadPool& compute,
                           const protocol::Limits& limits) {
    if (std::string loading = loads.unready(); !loading.empty()) return loading;
    if (std::string shortage = descriptors_fault(); !shortage.empty()) return shortage;
    const auto most = std::chrono::milliseconds(limits.chunk_ms_max) + stuck_grace;
    if (compute.longest_task() <= most) return {};
    return "a worker thread is stuck: its task has run for more than " +
           std::to_string(most.count()) + " ms";
}

}  // namespace

Daemon::Daemon(Options options, ReadOptions read_again, std::shared_ptr<const Registry> registry,
               std::unique_ptr<StateFolder> state)
    : options_(std::move(options)),
      read_again_(std::move(read_again)),
      registry_(std::move(registry)),
      limits_(limits_in_force(options_)),
      budget_(options_.memory),
      peers_(limits_, budget_, metrics_),
      state_(std::move(state)),
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
                blocking_},
      waker_(services_, [this](std::function<void()> done) { asio::post(io_, std::move(done)); }),
      poser_(services_, [this](std::function<void()> done) { asio::post(io_, std::move(done)); }),
      selections_(blocking_),
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
      backends_(make_backends({options_.cuda_pack, *registry_, budget_, metrics_, limits_})),
      compute_(options_.threads, FairThreadPool::Time::processor, spare_threads(options_.threads)),
      blocking_(imports_max, FairThreadPool::Time::clock, 0, principal_imports_max),
      disk_(state_ ? disk_threads : 0, FairThreadPool::Time::clock, 0, principal_disk_threads),
      signals_(io_, SIGTERM, SIGINT, SIGHUP),
      drain_timer_(io_),
      detached_timer_(io_),
      lost_timer_(io_),
      credentials_timer_(io_),
      watchdog_timer_(io_),
      credentials_(options_.security, limits_, &metrics_.logins_refused),
      connections_(
          io_, services_, context_,
          [this](const PeerIdentity& peer, const wire::Hello& hello, const protocol::Limits&) {
              return credentials_.authentication().identify(peer, protocol::text(hello.token()),
                                                            Clock::now(), WallClock::now());
          }),
      page_access_(credentials_.authentication(), [this] { end_revoked(); }),
      site_(options_.http.hosts),
      http_(io_, site_, limits_, metrics_,
            [this](auto transport, auto descriptors) {
                connections_.accept(std::move(transport), descriptors);
            }),
      start_loads_(io_, services_),
      handover_(io_, services_) {
    peers_.set_spares([this] { scenes_.drop_spares(); });
    scenes_.set_disposal(
        [this](std::shared_ptr<const void> memory) { dispose(compute_, "", std::move(memory)); });
    credentials_.set_disposal(
        [this](std::shared_ptr<const void> rows) { dispose(compute_, "", std::move(rows)); });
    services_.administration = this;
    services_.state = state_.get();
    services_.waker = state_ ? &waker_ : nullptr;
    services_.changes = state_ ? &handover_.changes() : nullptr;
    services_.disk = &disk_;
    services_.poser = &poser_;
    services_.selections = &selections_;
    if (state_) scenes_.adopt(*state_);
}

void Daemon::follow(Predecessor predecessor) {
    inherited_.add(predecessor.take_sockets());
    predecessor_ = std::move(predecessor);
}

Result<void> Daemon::listen(const StateLock& lock) {
    if (const auto loaded = credentials_.load(); !loaded) return loaded;
    for (const std::string& uri : options_.listen) {
        auto address = parse_address(uri);
        if (!address) return tl::unexpected(address.error());
        inherited_.claim(*address, uri);
        const MakeTransport make = transport_of(*find_scheme(scheme_of(*address)));
        auto listener = Listener::open(
            io_, *address, "--listen", options_.socket,
            [this, make](Socket socket, Descriptors descriptors) {
                connections_.accept(make(std::move(socket), {credentials_.tls()}), descriptors);
            });
        if (!listener) return tl::unexpected(listener.error());
        open_.push_back({"listen", uri, (*listener)->address()});
        listeners_.push_back(std::move(*listener));
    }
    if (options_.http.address != "off")
        if (const auto listening = listen_http(); !listening) return listening;
    inherited_.warn_of_unclaimed();
    if (state_ == nullptr) return {};
    return handover_.await_successor(
        lock.descriptor(), {[this] { return handed_sockets(); }, [this] { begin_to_drain(true); }});
}

Result<void> Daemon::listen_http() {
    auto address = parse_http_address(options_.http.address);
    if (!address) return tl::unexpected(address.error());
    inherited_.claim(*address, options_.http.address);
    const bool is_encrypted = scheme_of(*address) == "https";
    auto listener =
        Listener::open(io_, *address, "--http", options_.socket,
                       [this, is_encrypted](Socket socket, Descriptors descriptors) {
                           http_.accept(std::move(socket), descriptors,
                                        is_encrypted ? credentials_.tls().get() : nullptr);
                       });
    if (!listener && options_.http.given) return tl::unexpected(listener.error());
    if (!listener) {
        log(LogLevel::warn, "http_off", {{"reason", listener.error().message}});
        return {};
    }
    open_.push_back({"http", options_.http.address, (*listener)->address()});
    http_listener_ = std::move(*listener);
    http_.set_proxies(AddressSet(options_.http.proxies));
    site_.set_address(std::get<TcpAddress>(http_listener_->address()));
    site_.set_access(page_access_);
    services_.page_logins = &credentials_.authentication().logins();
    serve_health();
    return {};
}

void Daemon::serve_health() {
    site_.set_metrics([this](const Principal& reader) {
        return exposition(services_, reader, credentials_.certificate_days_left(WallClock::now()));
    });
    site_.set_shortage(descriptors_fault);
    site_.set_unready([this] {
        return serving_ ? unready_reason(start_loads_, compute_, limits_)
                        : std::string("the daemon is starting");
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
        const std::string uri = services_.page = http_uri();
        http_listener_->start();
        log(LogLevel::info, "http",
            {{"page", uri},
             {"hint", is_beyond_loopback(http_listener_->address()) ? "raynest open shows it"
                                                                    : forward_hint(uri)}});
    }
    log_openness(open_, options_);
    await_signal();
    repeat(lost_timer_, lost_look, [this] {
        connections_.close_lost();
        if (auto unused = trace_buffers_.trim(); !unused.empty())
            dispose(compute_, "", std::move(unused));
        poser_.drop_idle();
        selections_.drop_idle();
        log_left_out();
        if (state_) state_->note(scenes_.take_uses());
        if (state_ && state_->has_work())
            disk_.submit("", Priority::low, [this] { state_->collect(); });
    });
    repeat(credentials_timer_, credentials_look, [this] {
        look_at_credentials();
        connections_.close_deserted();
        waker_.drop_deserted();
        page_access_.look_at_logins();
    });
    serving_ = true;
    start_loads_.start(options_.load);
    if (state_)
        for (const AsleepScene& scene : scenes_.pinned_asleep()) waker_.wake(scene);
    if (!options_.ready_file.empty()) {
        // Fail without the file: programs that wait for it would wait for ever.
        if (const auto written = write_ready_file(options_.ready_file, uris, http_uri()); !written)
            return tl::unexpected(written.error());
    }
    if (predecessor_) take_place();
    notify("READY=1");
    // The io thread proves that it still handles events; jobs run on other threads.
    if (const auto interval = watchdog_interval())
        repeat(watchdog_timer_, *interval, [] { notify("WATCHDOG=1"); });
    for (;;) {
        try {
            is_logged(LogLevel::debug) ? IoTurn::run_and_log([this] { return io_.run_one() != 0; })
                                       : void(io_.run());
            break;
        } catch (const std::exception& error) {
            // Only this handler's work is lost; it is outside the connections' coroutines.
            log_limited(LogLevel::error, "handler_failed", "", {{"reason", error.what()}});
        }
    }
    if (state_ && !state_->is_closed()) {
        state_->note(scenes_.take_uses());
        state_->collect();
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
            elsewhere([read = reload()]() -> std::function<void()> {
                return [take = read()] { (void)take(); };
            });
            return await_signal();
        }
        if (drain_deadline_ != Clock::time_point::max()) {
            log(LogLevel::warn, "stopping_at_once");
            end_at_once();
        }
        begin_to_drain(handover_.is_handed());
        await_signal();
    });
}

void Daemon::begin_to_drain(bool has_successor) {
    if (drain_deadline_ != Clock::time_point::max()) return;
    log(LogLevel::info, "draining", {{"connections", std::to_string(connections_.size())}});
    if (!has_successor) notify("STOPPING=1");
    drain_deadline_ = Clock::now() + std::chrono::milliseconds(limits_.drain_ms_max);
    for (const auto& listener : listeners_) has_successor ? listener->leave() : listener->close();
    if (has_successor && http_listener_) http_listener_->leave();
    if (has_successor)
        why_draining_ = "another raynestd has taken the place of this one: connect again";
    connections_.drain(why_draining_);
    start_loads_.stop();
    waker_.stop();
    // The HTTP port stays open until the end: /readyz tells that the daemon drains.
    site_.drain();
    look_drained();
}

void Daemon::look_drained() {
    peers_.dismiss(why_draining_);
    // Ends connections that had time to fetch an answer.
    connections_.drain(why_draining_);
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

void Daemon::take_place() {
    handover_.serve_after(std::move(*std::exchange(predecessor_, {})));
    for (const auto& listener : listeners_)
        if (const auto taken = listener->take_file(options_.socket); !taken)
            log(LogLevel::error, "socket_access_failed",
                {{"listen", listener->uri()}, {"reason", taken.error().message}});
    inherited_.drop_unclaimed();
}

std::vector<HandedSocket> Daemon::handed_sockets() {
    std::vector<HandedSocket> sockets;
    const auto add = [&](const std::string& value, Listener& listener) {
        sockets.push_back(
            {value, listener.has_file(), Fd(fcntl(listener.descriptor(), F_DUPFD_CLOEXEC, 0))});
    };
    for (std::size_t i = 0; i < listeners_.size(); ++i) add(options_.listen[i], *listeners_[i]);
    if (http_listener_) add(options_.http.address, *http_listener_);
    return sockets;
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

void Daemon::repeat(asio::steady_timer& timer, std::chrono::microseconds pause,
                    std::function<void()> act) {
    timer.expires_after(pause);
    timer.async_wait([this, &timer, pause, act = std::move(act)](const SystemError& error) {
        if (error) return;
        // First: it goes on even if this time fails.
        repeat(timer, pause, act);
        act();
    });
}

namespace {

int failed(const Error& error) {
    std::fprintf(stderr, "%sraynestd: %s\n", journal_priority(LogLevel::error).data(),
                 error.message.c_str());
    return 1;
}

/// Takes the lock of a folder whose daemon may just have ended: its lock goes a moment after its
/// other end of a stream.
Result<StateLock> lock_once_free(const std::filesystem::path& folder) {
    constexpr int tries = 10;
    for (int i = 1;; ++i) {
        auto lock = StateLock::take(folder);
        if (lock || i == tries) return lock;
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
}

}  // namespace

int run_daemon(Options options, ReadOptions read_again) {
    (void)std::signal(SIGPIPE, SIG_IGN);
    (void)std::signal(SIGXFSZ, SIG_IGN);  // write() says EFBIG
    auto lock = prepare_start(options);
    if (!lock) return failed(lock.error());
    const auto registry = Registry::load({options.pack_dirs, options.target});
    if (!registry) return failed(registry.error());
    for (const auto& [event, reason] : start_warnings(options))
        log(LogLevel::warn, event, {{"reason", reason}});
    std::optional<Predecessor> predecessor;
    if (options.takeover && lock->descriptor() < 0) {
        // Try all that can fail without the folder first.
        if (const auto fault = start_fault(options))
            return failed({ErrorCode::io_failed, "--" + fault->option + " " + fault->why});
        auto asked = Predecessor::ask(options.state);
        if (asked) {
            lock = asked->take_lock();
            predecessor = std::move(*asked);
        } else if (lock = lock_once_free(options.state); !lock) {
            return failed(asked.error());
        }  // else it has ended meanwhile
    }
    auto state = StateFolder::open(
        options.state, predecessor ? StateFolder::Leftovers::keep : StateFolder::Leftovers::remove);
    if (!state) return failed(state.error());
    Daemon daemon(std::move(options), std::move(read_again), *registry, std::move(*state));
    if (predecessor) daemon.follow(std::move(*predecessor));
    if (const auto listening = daemon.listen(*lock); !listening) return failed(listening.error());
    if (const auto ended = daemon.run(); !ended) return failed(ended.error());
    return 0;
}

}  // namespace raynest::server
