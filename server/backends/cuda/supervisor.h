// The CUDA worker as jobs see it: chunks of rays go there, or it says why not. Behind it is a
// process that may die, and is started again.
//
//   starting ──its first answers are the CPU's──► up ──fault──► down ──after a while──► starting
//
// After a fault the worker is left alone for cuda_retry_ms, twice as long after each fault that
// follows, up to cuda_retry_ms_max; one that was up for so long counts as the first. Nothing waits
// for a start: meanwhile jobs run on the CPU, with the same answers. Where a start finds no device,
// who demands one is told that there is none, not when to try again.
#pragma once

#include "engine/packs/registry.h"
#include "engine/scene/snapshot.h"
#include "protocol/errors.h"
#include "protocol/limits.h"
#include "server/backends/backend.h"
#include "server/backends/cuda/process.h"
#include "server/diag/metrics.h"
#include "server/store/budget.h"

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

namespace raynest::server::device {

/// Of what a device is asked.
struct Kernel {
    std::string_view variant;
    Precision precision = precision_watertight;
    Query query = query_closest;
    std::size_t param_count = 0;
};

/// Thread-safe.
class Supervisor {
public:
    struct Options {
        std::vector<std::string> command;  ///< ends up in run_worker_process()
        std::uint32_t slots = 1;           ///< calls at a time
        SlotShape shape;                   ///< of a call
    };
    /// The registry's CPU target must be one that promises the device's bits: not v2.
    Supervisor(Options options, const Registry& registry, Budget& budget, Metrics& metrics,
               const protocol::Limits& limits);
    /// Ends the process; no call may be under way.
    ~Supervisor();
    Supervisor(const Supervisor&) = delete;

    [[nodiscard]] std::uint32_t slots() const { return options_.slots; }

    /// Nothing where it takes such calls now.
    [[nodiscard]] std::optional<Unavailable> unavailable_reason(const Kernel& kernel,
                                                                const Snapshot& scene);

    /// Has it kernels of this variant? Not while it is not up.
    [[nodiscard]] bool has(std::string_view variant);

    /// Blocking, for as long as a scene may take to get there: fills in the hits and hit counts of
    /// `call`, whose scene is that of `scene`, and which fits the shape. With `made`, which are the
    /// call's rays, the device makes them itself. What is refused has to be traced elsewhere.
    tl::expected<void, Unavailable> trace(const Kernel& kernel, const Snapshot& scene,
                                          const TraceCall& call, const PinholeRays* made);

private:
    using Clock = std::chrono::steady_clock;
    using ProcessPointer = std::shared_ptr<Process>;
    enum class State { starting, up, down };

    /// A slot of a process, given back at its end.
    class Lease;
    /// The turn of one scene to get there; its end is the next one's.
    class Turn;

    struct Refused {
        Unavailable refusal;
        unsigned losses = 0;  ///< of processes, by this scene, each soon after the one before
        Clock::time_point lost;
        Clock::time_point until;
    };
    Refused& refused_locked(const Snapshot& scene);

    void run();
    /// Starts a process and probes it (probe.h).
    Result<ProcessPointer> begin();
    Result<ProcessPointer> begin_without_throwing();
    Result<void> probe_process(Process& process);
    [[nodiscard]] Unavailable refusal_locked() const;
    tl::expected<Lease, Unavailable> take_slot();
    /// Nothing where another thread brought the scene meanwhile.
    tl::expected<std::optional<Turn>, Unavailable> take_turn(const Snapshot& scene);
    tl::expected<void, Unavailable> trace_if_up(const Kernel& kernel, const Snapshot& scene,
                                                const TraceCall& call, const PinholeRays* made);
    /// A call on a slot of its own. False where the scene is not there.
    tl::expected<bool, Unavailable> attempt(const Kernel& kernel, const Snapshot& scene,
                                            const TraceCall& call, const PinholeRays* made);
    /// The rays of `call` on a slot that is the caller's: its answers lie there.
    tl::expected<bool, Unavailable> trace_on(Process& process, std::uint32_t slot,
                                             const Kernel& kernel, const Snapshot& scene,
                                             const TraceCall& call, const PinholeRays* made,
                                             std::chrono::milliseconds patience);
    /// Gets the scene there, or waits for the thread that is at it. Scenes get there one at a time.
    tl::expected<void, Unavailable> bring(const Snapshot& scene);
    tl::expected<void, Unavailable> load(Process& process, std::uint32_t slot,
                                         const Snapshot& scene);
    /// Nothing where the process did what it was asked.
    std::optional<Unavailable> refusal_of(const Result<Outcome>& outcome, const Snapshot& scene);
    Unavailable remember(const Snapshot& scene, Unavailable refusal);
    /// The process is no good any more, found with this scene. Gives the refusal with the reason
    /// that was found first.
    Unavailable lose(const ProcessPointer& process, const Snapshot& scene, Unavailable refusal);
    void lose_locked(std::string reason);
    /// Until it is lost, or the daemon ends: an end that no call sees, this does.
    void watch(std::unique_lock<std::mutex>& lock);

    const Options options_;
    const Registry& registry_;
    Budget& budget_;
    Metrics& metrics_;
    const protocol::Limits& limits_;

    std::mutex mutex_;
    std::condition_variable changed_;
    State state_ = State::starting;
    std::atomic<bool> stopping_{false};
    ProcessPointer process_;            ///< of State::up
    ProcessPointer lost_;               ///< the one before
    ProcessPointer starting_;           ///< of State::starting, while it is probed
    std::vector<std::uint32_t> free_;   ///< slots of it
    std::string reason_ = "it starts";  ///< why it is not up
    bool absent_ = false;               ///< the last start found no device, or no pack for it
    std::string logged_;                ///< the last reason in the log
    Clock::time_point since_;           ///< of State::up
    Clock::time_point retry_at_;        ///< of State::down
    std::chrono::milliseconds pause_{};
    std::map<std::string, Refused> refused_;  ///< scenes, by hash

    std::string loading_;  ///< hash of the one scene that is on its way to the device
    std::thread thread_;   ///< run(); starts last
};

}  // namespace raynest::server::device
