#include "server/daemon.h"

#include "engine/packs/load.h"
#include "protocol/control.h"
#include "server/handlers/handler.h"
#include "server/handlers/tracing.h"
#include "server/jobs/admission.h"
#include "server/jobs/detached.h"
#include "server/jobs/runner.h"
#include "server/jobs/workers.h"
#include "server/log.h"
#include "server/net/asio.h"
#include "server/net/listener.h"
#include "server/net/principal.h"
#include "server/net/session.h"
#include "server/ready_file.h"
#include "server/store/scene_store.h"

#include <sys/resource.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <unordered_set>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// For tasks that wait while long ones hold all threads: the chunks that three requests have under
/// way, and some for others.
constexpr unsigned spare_threads(unsigned threads) {
    return 2 * threads + 16;
}
/// Imports at once; each is a process of its own with limits of its own.
constexpr unsigned imports_max = 2;
/// Chunks on a GPU at once: one's copies run beside another's kernel. Fewer where --memory is
/// small.
constexpr unsigned cuda_calls_max = 4;
/// For calls of other scenes, while one's calls wait for it to get there.
constexpr unsigned cuda_spares = 4;
static_assert(cuda_calls_max <= device::slots_max);
constexpr std::chrono::milliseconds drain_look{20};
/// How often peers are looked for whose machine or network is gone.
constexpr std::chrono::seconds lost_look{5};
/// For clients to hear that their jobs are given up.
constexpr std::chrono::milliseconds last_words_time{1000};
constexpr int exit_forced = 3;

class Daemon {
public:
    Daemon(const Options& options, std::shared_ptr<const Registry> registry);

    Result<void> listen();
    /// Serves until drained. Fails when the ready file cannot be written.
    Result<void> run();

private:
    void accept(Socket socket, Listener::Descriptors descriptors);
    /// Why there is no place for one connection more, if nobody gives way to it.
    std::optional<std::string> why_full(const std::string& principal,
                                        Listener::Descriptors descriptors);
    void await_signal();
    void drain();
    void look_drained();
    void look_after_detached();
    void look_for_lost();

    const Options& options_;
    const std::shared_ptr<const Registry> registry_;
    const protocol::Limits limits_;
    Metrics metrics_;
    Budget budget_;
    Peers peers_;
    SceneStore scenes_;
    Admission admission_;
    BriefTurn brief_turn_;
    Coalescer coalescer_;
    asio::io_context io_{1};
    Services services_;
    Engine engine_;
    DetachedJobs detached_;
    std::unique_ptr<device::Worker> cuda_;
    // Tasks use all of the above: workers end before it does.
    Workers compute_;
    Workers blocking_;
    Workers device_;
    asio::signal_set signals_;
    asio::steady_timer drain_timer_;
    asio::steady_timer detached_timer_;
    asio::steady_timer lost_timer_;
    std::vector<std::unique_ptr<Listener>> listeners_;
    std::unordered_set<std::shared_ptr<Session>> sessions_;
    Clock::time_point drain_deadline_ = Clock::time_point::max();
    bool cut_short_ = false;  ///< the drain took too long
};

/// This program again, as main.cpp understands it: the packs decide which primitives a file may
/// hold.
std::vector<std::string> import_command(const Options& options) {
    std::vector<std::string> command = {std::filesystem::read_symlink("/proc/self/exe").string(),
                                        std::string(import_child_flag), options.target};
    for (const auto& folder : options.pack_dirs)
        command.push_back(std::filesystem::absolute(folder).string());
    return command;
}

/// With a pack; the error says why there is to be no worker all the same.
tl::expected<device::Worker::Options, std::string> cuda_options(const Options& options,
                                                                const Registry& registry,
                                                                const protocol::Limits& limits) {
    // On a CPU that has not its bits a GPU would give other answers than the CPU that it falls back
    // to: v2 has no fma.
    const bool bits = std::all_of(registry.variants().begin(), registry.variants().end(),
                                  [](const Variant& variant) { return variant.target != "v2"; });
    if (!bits)
        return tl::unexpected<std::string>(
            "target v2 does not promise the answers of a GPU; it takes v3 or v4");
    device::Worker::Options of;
    of.command = {std::filesystem::read_symlink("/proc/self/exe").string(),
                  std::string(device_worker_flag), options.cuda_pack.string()};
    of.shape = {call_rays_max(limits), hit_bytes_max / sizeof(HitRecord)};
    const std::uint64_t room = device::slots_share(options.memory) / of.shape.bytes();
    of.slots = static_cast<std::uint32_t>(std::clamp<std::uint64_t>(room, 1, cuda_calls_max));
    return of;
}

std::unique_ptr<device::Worker> make_cuda(const Options& options, const Registry& registry,
                                          Budget& budget, Metrics& metrics,
                                          const protocol::Limits& limits, std::string& why_not) {
    if (options.cuda_pack.empty()) return nullptr;
    auto of = cuda_options(options, registry, limits);
    if (of)
        return std::make_unique<device::Worker>(std::move(*of), registry, budget, metrics, limits);
    log(LogLevel::warn, "cuda_off", {{"reason", of.error()}});
    why_not += ": " + of.error();
    return nullptr;
}

Daemon::Daemon(const Options& options, std::shared_ptr<const Registry> registry)
    : options_(options),
      registry_(std::move(registry)),
      limits_(options.limits),
      budget_(options.memory),
      peers_(limits_, budget_, metrics_),
      scenes_(budget_, limits_),
      admission_(limits_),
      services_{*registry_,
                scenes_,
                budget_,
                metrics_,
                limits_,
                ImportLimits{},
                options.scene_root,
                import_command(options),
                admission_,
                detached_,
                peers_,
                nullptr},
      engine_{compute_,
              blocking_,
              device_,
              admission_,
              metrics_,
              limits_,
              [this](std::function<void()> done) { asio::post(io_, std::move(done)); },
              budget_,
              brief_turn_,
              coalescer_,
              peers_},
      detached_(engine_, [this] { look_after_detached(); }),
      cuda_(make_cuda(options, *registry_, budget_, metrics_, limits_, services_.why_no_cuda)),
      compute_(options.threads, Workers::Time::processor, spare_threads(options.threads)),
      blocking_(imports_max, Workers::Time::clock),
      device_(cuda_ != nullptr ? cuda_->slots() : 0, Workers::Time::clock, cuda_spares),
      signals_(io_, SIGTERM, SIGINT, SIGHUP),
      drain_timer_(io_),
      detached_timer_(io_),
      lost_timer_(io_) {
    services_.cuda = cuda_.get();
}

Result<void> Daemon::listen() {
    for (const std::string& uri : options_.listen) {
        const auto address = parse_address(uri);
        if (!address) return tl::unexpected(address.error());
        auto listener =
            Listener::open(io_, *address, options_.socket,
                           [this](Socket socket, Listener::Descriptors descriptors) {
                               accept(std::move(socket), descriptors);
                           });
        if (!listener) return tl::unexpected(listener.error());
        listeners_.push_back(std::move(*listener));
    }
    return {};
}

Result<void> Daemon::run() {
    std::vector<std::string> uris;
    for (const auto& listener : listeners_) {
        listener->start();
        uris.push_back(listener->uri());
        log(LogLevel::info, "listening", {{"uri", listener->uri()}});
    }
    await_signal();
    look_for_lost();
    if (!options_.ready_file.empty()) {
        // Whoever waits for the file would wait for ever.
        if (const auto written = write_ready_file(options_.ready_file, uris); !written)
            return tl::unexpected(written.error());
    }
    for (;;) {
        try {
            io_.run();
            break;
        } catch (const std::exception& error) {
            // A handler outside of the connections' coroutines: what it belonged to is lost.
            log(LogLevel::error, "handler_failed", {{"reason", error.what()}});
        }
    }
    if (!options_.ready_file.empty()) remove_ready_file(options_.ready_file);
    log(LogLevel::info, "stopped");
    return {};
}

std::optional<std::string> Daemon::why_full(const std::string& principal,
                                            Listener::Descriptors descriptors) {
    if (peers_.size_of(principal) >= limits_.principal_connections_max) {
        if (peers_.make_room(Resource::connections, principal, 1, Peers::Whose::own))
            return std::nullopt;
        return "the daemon has no free connections for " + principal +
               ", which has all that principal_connections_max = " +
               std::to_string(limits_.principal_connections_max) + " allows; close one of them";
    }
    const bool used_up = descriptors == Listener::Descriptors::used_up;
    if ((!used_up && peers_.size() < limits_.connections_max) ||
        peers_.make_room(Resource::connections, principal))
        return std::nullopt;
    return "the daemon has no free connections" +
           (used_up ? ": its file descriptors are used up; raise LimitNOFILE or ulimit -n for it"
                    : ", connections_max = " + std::to_string(limits_.connections_max)) +
           "; try again later";
}

void Daemon::accept(Socket socket, Listener::Descriptors descriptors) {
    ++metrics_.connections_accepted;
    const std::string principal = principal_of(socket);
    if (auto why = why_full(principal, descriptors)) {
        ++metrics_.connections_refused;
        ++metrics_.connections_closed;
        return say_last(socket, {Code::busy, std::move(*why), 1000});
    }
    const auto session =
        std::make_shared<Session>(io_, std::move(socket), principal, services_, engine_,
                                  [this](const std::shared_ptr<Session>& closed) {
                                      sessions_.erase(closed);
                                      peers_.leave(*closed);
                                  });
    try {
        sessions_.insert(session);
        peers_.join(*session);
        session->start();
    } catch (const std::bad_alloc&) {
        session->stop();
    }
}

void Daemon::await_signal() {
    signals_.async_wait([this](const SystemError& error, int signal) {
        if (error) return;
        if (signal == SIGHUP) {
            log(LogLevel::info, "hangup_ignored");
            return await_signal();
        }
        const bool draining = drain_deadline_ != Clock::time_point::max();
        if (draining) {
            log(LogLevel::warn, "stopping_at_once");
            std::_Exit(exit_forced);
        }
        drain();
        await_signal();
    });
}

void Daemon::drain() {
    log(LogLevel::info, "draining", {{"connections", std::to_string(sessions_.size())}});
    drain_deadline_ = Clock::now() + std::chrono::milliseconds(limits_.drain_ms_max);
    for (const auto& listener : listeners_) listener->close();
    // Nobody could fetch them any more.
    detached_.stop_running();
    const std::unordered_set<std::shared_ptr<Session>> sessions = sessions_;
    for (const auto& session : sessions) session->drain();
    look_drained();
}

void Daemon::look_drained() {
    peers_.dismiss();
    // Jobs of closed connections count too: their tasks still use what the daemon owns.
    const bool drained = sessions_.empty() && admission_.active() == 0;
    if (drained && !cut_short_) return io_.stop();
    const bool late = Clock::now() >= drain_deadline_;
    if (drained || (late && cut_short_)) std::_Exit(exit_forced);
    if (late) {
        log(LogLevel::warn, "drain_took_too_long", {{"jobs", std::to_string(admission_.active())}});
        cut_short_ = true;
        drain_deadline_ = Clock::now() + last_words_time;
        const std::unordered_set<std::shared_ptr<Session>> sessions = sessions_;
        for (const auto& session : sessions) session->give_up();
    }
    drain_timer_.expires_after(drain_look);
    drain_timer_.async_wait([this](const SystemError& error) {
        if (!error) look_drained();
    });
}

// What each connection's watchdog does for its own jobs.
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
        const std::unordered_set<std::shared_ptr<Session>> sessions = sessions_;
        for (const auto& session : sessions) session->stop_if_lost();
        look_for_lost();
    });
}

/// Connections need descriptors: take as many as the system grants.
void raise_descriptor_limit() {
    rlimit limit{};
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
    limit.rlim_cur = limit.rlim_max;
    (void)setrlimit(RLIMIT_NOFILE, &limit);
}

void warn_of_empty(const std::vector<std::filesystem::path>& pack_dirs) {
    for (const auto& folder : pack_dirs)
        if (const auto packs = packs_in(folder); packs && packs->empty())
            log(LogLevel::warn, "pack_dir_empty",
                {{"folder", folder.string()}, {"reason", "it holds no .so file"}});
}

int failed(const Error& error) {
    std::fprintf(stderr, "raynestd: %s\n", error.message.c_str());
    return 1;
}

}  // namespace

int run_daemon(const Options& options) {
    (void)std::signal(SIGPIPE, SIG_IGN);
    raise_descriptor_limit();
    // Before anything listens: a file of somebody else's ends the start.
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
    warn_of_empty(options.pack_dirs);
    Daemon daemon(options, *registry);
    if (const auto listening = daemon.listen(); !listening) return failed(listening.error());
    if (const auto ended = daemon.run(); !ended) return failed(ended.error());
    return 0;
}

}  // namespace raynest::server
