// Starts, probes, watches and restarts the CUDA worker process, and sends it chunks of rays.
//
//   starting ──probe succeeds──► up ──fault──► down ──after a pause──► starting
//
// The first pause is cuda_retry_ms; it doubles with each fault up to cuda_retry_ms_max. A worker
// that was up for longer than cuda_retry_ms_max resets the pause. Jobs do not wait for a start:
// they run on the CPU meanwhile, with the same answers. If a start finds no device, requests that
// demand one are refused without a time to retry.
#pragma once

#include "engine/packs/registry.h"
#include "engine/scene/snapshot.h"
#include "protocol/errors.h"
#include "protocol/limits.h"
#include "server/backends/cuda/process.h"
#include "server/execution/backend.h"
#include "server/ground/budget.h"
#include "server/ground/metrics.h"

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

/// Selects a kernel of the device.
struct Kernel {
    std::string_view variant;
    Query query = query_closest;
    std::size_t param_count = 0;
};

/// Owns the CUDA worker process. Thread-safe.
class Supervisor {
public:
    struct Options {
        std::vector<std::string> command;  ///< a program that calls run_worker_process()
        std::uint32_t slots = 1;           ///< maximum concurrent calls
        SlotShape shape;                   ///< maximum rays and hits of a call
    };
    /// The registry's CPU target must give the same bits as the device: v3 or v4, not v2.
    Supervisor(Options options, const Registry& registry, Budget& budget, Metrics& metrics,
               const protocol::Limits& limits);
    /// Kills the process. No call may be running.
    ~Supervisor();
    Supervisor(const Supervisor&) = delete;

    [[nodiscard]] std::uint32_t slots() const { return options_.slots; }

    /// Returns nothing if the worker accepts such calls at this moment.
    [[nodiscard]] std::optional<Unavailable> unavailable_reason(const Kernel& kernel,
                                                                const Snapshot& scene);

    /// Names the variants that the worker has kernels of; none while it is not up.
    [[nodiscard]] std::vector<std::string> kernels();

    /// Fills in the hits and hit counts of `call`. Blocking, up to the time limits of a call and of
    /// an upload of the scene. `call` refers to `scene` and fits Options::shape. If `made` is not
    /// null, the device generates the call's rays from it. Refused calls must be traced elsewhere.
    tl::expected<void, Unavailable> trace(const Kernel& kernel, const Snapshot& scene,
                                          const TraceCall& call, const PinholeRays* made);

private:
    using Clock = std::chrono::steady_clock;
    using ProcessPointer = std::shared_ptr<Process>;
    enum class State { starting, up, down };

    /// A slot of a process; the destructor returns it.
    class Lease;
    /// The right to upload a scene; one thread at a time has it. The destructor passes it on.
    class Turn;

    struct Refused {
        Unavailable refusal;
        unsigned losses = 0;     ///< processes lost with this scene, each soon after the one before
        Clock::time_point lost;  ///< time of the last loss
        Clock::time_point until;  ///< end of the refusal
    };
    Refused& refused_locked(const Snapshot& scene);

    void run();
    /// Starts a process and probes it (probe.h).
    Result<ProcessPointer> begin();
    Result<ProcessPointer> begin_without_throwing();
    Result<void> probe_process(Process& process);
    [[nodiscard]] Unavailable refusal_locked() const;
    tl::expected<Lease, Unavailable> take_slot();
    /// Waits for the turn to upload the scene; returns nothing if another thread uploaded it.
    tl::expected<std::optional<Turn>, Unavailable> take_turn(const Snapshot& scene);
    tl::expected<void, Unavailable> trace_if_up(const Kernel& kernel, const Snapshot& scene,
                                                const TraceCall& call, const PinholeRays* made);
    /// Takes a slot and makes the call on it. False if the device does not hold the scene.
    tl::expected<bool, Unavailable> attempt(const Kernel& kernel, const Snapshot& scene,
                                            const TraceCall& call, const PinholeRays* made);
    /// Makes the call on a slot that the caller holds. False if the device does not hold the scene.
    tl::expected<bool, Unavailable> trace_on(Process& process, std::uint32_t slot,
                                             const Kernel& kernel, const Snapshot& scene,
                                             const TraceCall& call, const PinholeRays* made,
                                             std::chrono::milliseconds time_limit);
    /// Uploads the scene, or waits for the thread that does. Scenes are uploaded one at a time.
    tl::expected<void, Unavailable> upload(const Snapshot& scene);
    tl::expected<void, Unavailable> load(Process& process, std::uint32_t slot,
                                         const Snapshot& scene);
    /// Returns nothing if the request succeeded.
    std::optional<Unavailable> refusal_of(const Result<Outcome>& outcome, const Snapshot& scene);
    /// Refuses the scene for `scene_pause`; returns `refusal`.
    Unavailable remember(const Snapshot& scene, Unavailable refusal);
    /// Kills the process after a fault while it handled this scene. Returns `refusal` with the
    /// reason that was found first.
    Unavailable lose(const ProcessPointer& process, const Snapshot& scene, Unavailable refusal);
    void lose_locked(std::string reason);
    /// Waits until the process is lost or the daemon stops; notices an exit between calls.
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
    ProcessPointer process_;            ///< the running process; set in State::up
    ProcessPointer lost_;               ///< the previous process, until run() destroys it
    ProcessPointer starting_;           ///< the process that is being probed
    std::vector<std::uint32_t> free_;   ///< free slots of process_
    std::string reason_ = "it starts";  ///< why the worker is not up
    bool absent_ = false;               ///< the last start found no device, or no pack for it
    std::string logged_;                ///< the last reason in the log
    Clock::time_point since_;           ///< begin of State::up
    Clock::time_point retry_at_;        ///< end of State::down
    std::chrono::milliseconds pause_{};
    std::map<std::string, Refused> refused_;  ///< by SceneText

    std::string loading_;  ///< the scene that is being uploaded; else empty
    std::thread thread_;   ///< executes run(); the last member, so that it starts last
};

}  // namespace raynest::server::device
