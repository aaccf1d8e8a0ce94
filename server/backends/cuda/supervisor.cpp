#include "server/backends/cuda/supervisor.h"

#include "engine/cuda/limits.h"
#include "server/backends/cuda/probe.h"
#include "server/backends/cuda/refusals.h"
#include "server/backends/cuda/upload.h"
#include "server/backends/cuda/validate_hits.h"
#include "server/ground/log.h"

#include <algorithm>
#include <limits>
#include <new>
#include <utility>

namespace raynest::server::device {
namespace {

using std::chrono::milliseconds;

/// Time for which a scene that found no room on the device is not tried again.
constexpr std::chrono::seconds scene_pause{10};
/// Time for which a scene is not tried again after `losses_max` lost processes; two may be chance.
/// Successful calls in between do not reset the count: only one of its chunks may be bad.
constexpr std::chrono::seconds loss_pause{300};
constexpr unsigned losses_max = 3;
/// Time after which the losses of a scene no longer count if no other follows.
constexpr std::chrono::seconds loss_memory{600};
/// Interval at which the watch checks that the process still runs.
constexpr milliseconds poll_interval{500};
constexpr std::size_t refused_max = 1024;

/// Returns the index of the kernel's variant in the worker's table, if the worker has the kernel.
std::optional<std::uint32_t> find_kernel(const Ready& ready, const Kernel& kernel) {
    for (std::uint32_t i = 0; i < ready.variant_count; ++i) {
        const VariantInfo& variant = ready.variants[i];
        if (variant.name.view() == kernel.variant)
            return (variant.queries >> kernel.query & 1U) != 0 ? std::optional(i) : std::nullopt;
    }
    return std::nullopt;
}

/// True if the device's variant has the same parameters as the CPU's variant and supports all of
/// its record types.
bool matches(const Ready& ready, const VariantInfo& theirs, const Variant& ours) {
    const std::span<const std::uint32_t> types(ready.record_types, ready.record_type_count);
    return theirs.params == fingerprint(ours.params()) && ours.params().size() <= params_max &&
           std::all_of(ours.record_types.begin(), ours.record_types.end(), [&](std::uint32_t type) {
               return std::find(types.begin(), types.end(), type) != types.end();
           });
}

std::string no_kernel(const Kernel& kernel) {
    return "it has no kernel for intersector '" + std::string(kernel.variant) + "' and query " +
           query_name(kernel.query);
}

}  // namespace

class Supervisor::Lease {
public:
    Lease(Supervisor& worker, ProcessPointer process, std::uint32_t slot)
        : worker_(&worker),
          process_(std::move(process)),
          slot_(slot) {}
    Lease(Lease&& other) noexcept = default;
    Lease& operator=(Lease&&) = delete;
    ~Lease() {
        if (process_ == nullptr) return;
        const std::lock_guard lock(worker_->mutex_);
        // Slots of a process that was lost in the meantime need not be returned.
        if (worker_->process_ == process_) worker_->free_.push_back(slot_);
        worker_->changed_.notify_all();
    }
    [[nodiscard]] const ProcessPointer& process() const { return process_; }
    [[nodiscard]] std::uint32_t slot() const { return slot_; }

private:
    Supervisor* worker_;
    ProcessPointer process_;
    std::uint32_t slot_;
};

class Supervisor::Turn {
public:
    explicit Turn(Supervisor& worker) : worker_(&worker) {}
    Turn(Turn&& other) noexcept : worker_(std::exchange(other.worker_, nullptr)) {}
    Turn& operator=(Turn&&) = delete;
    ~Turn() {
        if (worker_ == nullptr) return;
        const std::lock_guard lock(worker_->mutex_);
        worker_->loading_.clear();
        worker_->changed_.notify_all();
    }

private:
    Supervisor* worker_;
};

Supervisor::Supervisor(Options options, const Registry& registry, Budget& budget, Metrics& metrics,
                       const protocol::Limits& limits)
    : options_(std::move(options)),
      registry_(registry),
      budget_(budget),
      metrics_(metrics),
      limits_(limits),
      thread_([this] { run(); }) {}

Supervisor::~Supervisor() {
    {
        const std::lock_guard lock(mutex_);
        stopping_ = true;
        for (const ProcessPointer& process : {process_, starting_})
            if (process != nullptr) process->kill();
    }
    changed_.notify_all();
    thread_.join();
}

// Starts all processes on this one thread, because a process dies with the thread that started it.
void Supervisor::run() {
    const milliseconds pause_max(limits_.cuda_retry_ms_max);
    std::unique_lock lock(mutex_);
    while (!stopping_) {
        state_ = State::starting;
        lock.unlock();
        auto begun = begin_without_throwing();
        lock.lock();
        if (stopping_) break;
        if (begun) {
            process_ = std::move(*begun);
            free_.clear();
            for (std::uint32_t slot = 0; slot < options_.slots; ++slot) free_.push_back(slot);
            state_ = State::up;
            absent_ = false;
            since_ = Clock::now();
            log(LogLevel::info, "cuda_up", {{"device", process_->ready().text.printable()}});
            ++metrics_.cuda_starts;
            logged_.clear();
            watch(lock);
            // Destroy the lost process without the lock: the destructor waits for its end.
            lock.unlock();
            lost_ = nullptr;
            lock.lock();
            if (stopping_) break;
            if (Clock::now() - since_ > pause_max) pause_ = milliseconds(0);
        } else {
            state_ = State::down;
            reason_ = begun.error().message;
            absent_ = begun.error().code == ErrorCode::pack_invalid;
        }
        pause_ = std::max(milliseconds(limits_.cuda_retry_ms), std::min(2 * pause_, pause_max));
        retry_at_ = Clock::now() + pause_;
        // Log each reason once, and a machine without a GPU as information only.
        const LogLevel level = absent_ ? LogLevel::info : LogLevel::warn;
        log(std::exchange(logged_, reason_) == reason_ ? LogLevel::debug : level, "cuda_down",
            {{"reason", reason_}, {"retry_ms", std::to_string(pause_.count())}});
        changed_.wait_until(lock, retry_at_, [this] { return stopping_.load(); });
    }
}

void Supervisor::watch(std::unique_lock<std::mutex>& lock) {
    const auto over = [this] { return stopping_ || state_ == State::down; };
    while (!changed_.wait_for(lock, poll_interval, over)) {
        if (const auto end = process_->end()) lose_locked("the worker " + *end);
    }
}

Result<Supervisor::ProcessPointer> Supervisor::begin_without_throwing() {
    try {
        return begin();
    } catch (const std::bad_alloc&) {
        return fail(ErrorCode::limit_exceeded, "the daemon has no memory for its start");
    }
}

Result<Supervisor::ProcessPointer> Supervisor::begin() {
    auto process = Process::start({options_.command, options_.slots, options_.shape, &budget_,
                                   milliseconds(limits_.cuda_start_ms_max), &stopping_});
    if (!process) return process;
    {
        const std::lock_guard lock(mutex_);
        starting_ = *process;
        if (stopping_) (*process)->kill();
    }
    const auto probed = probe_process(**process);
    const std::lock_guard lock(mutex_);
    starting_ = nullptr;
    if (!probed) return tl::unexpected(probed.error());
    return process;
}

Result<void> Supervisor::probe_process(Process& process) {
    std::vector<const Variant*> variants;
    for (const Variant& variant : registry_.variants()) {
        const auto index = find_kernel(process.ready(), {variant.name});
        if (!index) continue;
        if (!matches(process.ready(), process.ready().variants[*index], variant))
            return fail(ErrorCode::pack_invalid,
                        "its kernel pack does not match this daemon; rebuild the pack");
        variants.push_back(&variant);
    }
    return probe(variants,
                 [&](const Variant& variant, Query query, const Snapshot& scene,
                     const TraceCall& call, const PinholeRays* made) -> Result<void> {
                     // Allow the first call seconds: the driver translates kernels that were not
                     // compiled for this GPU.
                     const auto attempt = [&] {
                         return trace_on(process, 0, {variant.name, query}, scene, call, made,
                                         milliseconds(limits_.cuda_start_ms_max));
                     };
                     auto traced = attempt();
                     if (traced && !*traced) {
                         const auto loaded = load(process, 0, scene);
                         if (!loaded) return fail(ErrorCode::internal, loaded.error().reason);
                         traced = attempt();
                     }
                     if (!traced) return fail(ErrorCode::internal, traced.error().reason);
                     if (!*traced)
                         return fail(ErrorCode::internal, "its scene was evicted at once");
                     return {};
                 });
}

Unavailable Supervisor::refusal_locked() const {
    if (absent_) return Unavailable{reason_};
    if (state_ == State::starting) return later("it starts", 1000);
    const auto left = std::chrono::ceil<milliseconds>(retry_at_ - Clock::now());
    constexpr std::int64_t most = std::numeric_limits<std::uint32_t>::max();
    const auto wait = std::clamp<std::int64_t>(left.count(), 100, most);
    return later(reason_, static_cast<std::uint32_t>(wait));
}

std::vector<std::string> Supervisor::kernels() {
    const std::lock_guard lock(mutex_);
    std::vector<std::string> names;
    if (state_ != State::up) return names;
    const Ready& ready = process_->ready();
    for (std::uint32_t i = 0; i < ready.variant_count; ++i)
        names.emplace_back(ready.variants[i].name.view());
    return names;
}

std::optional<Unavailable> Supervisor::unavailable_reason(const Kernel& kernel,
                                                          const Snapshot& scene) {
    const std::lock_guard lock(mutex_);
    if (state_ != State::up) return refusal_locked();
    if (!find_kernel(process_->ready(), kernel)) return Unavailable{no_kernel(kernel)};
    const SceneView& view = scene.view();
    const std::uint32_t levels = view.objects[view.root].levels;
    if (levels > cuda::levels_max)
        return Unavailable{"the scene is nested too deep for it: " + std::to_string(levels) +
                           " levels, at most " + std::to_string(cuda::levels_max)};
    const auto refused = refused_.find(scene.arena_id());
    if (refused == refused_.end()) return std::nullopt;
    if (Clock::now() < refused->second.until) return refused->second.refusal;
    return std::nullopt;
}

tl::expected<Supervisor::Lease, Unavailable> Supervisor::take_slot() {
    std::unique_lock lock(mutex_);
    // Wait without a limit: the calls and loads that hold slots have time limits.
    changed_.wait(lock, [this] { return stopping_ || state_ != State::up || !free_.empty(); });
    if (stopping_) return tl::unexpected(later("the daemon stops", 1000));
    if (state_ != State::up) return tl::unexpected(refusal_locked());
    const std::uint32_t slot = free_.back();
    free_.pop_back();
    return Lease(*this, process_, slot);
}

tl::expected<std::optional<Supervisor::Turn>, Unavailable> Supervisor::take_turn(
    const Snapshot& scene) {
    const auto end = Clock::now() + load_time_max(limits_, scene.bytes().size());
    std::unique_lock lock(mutex_);
    while (!loading_.empty()) {
        if (loading_ == scene.arena_id()) {
            // Another thread loads this scene and observes the time limit.
            changed_.wait(lock, [&] { return loading_ != scene.arena_id(); });
            return std::nullopt;
        }
        if (changed_.wait_until(lock, end) == std::cv_status::timeout) {
            lock.unlock();
            return tl::unexpected(
                remember(scene, later("other scenes are being uploaded to it", 1000)));
        }
    }
    loading_ = scene.arena_id();
    return Turn(*this);
}

tl::expected<void, Unavailable> Supervisor::trace(const Kernel& kernel, const Snapshot& scene,
                                                  const TraceCall& call, const PinholeRays* made) {
    auto traced = trace_if_up(kernel, scene, call, made);
    ++(traced ? metrics_.cuda_calls : metrics_.cuda_refusals);
    return traced;
}

tl::expected<void, Unavailable> Supervisor::trace_if_up(const Kernel& kernel, const Snapshot& scene,
                                                        const TraceCall& call,
                                                        const PinholeRays* made) {
    // Calls of other scenes may evict this one between its upload and its call.
    constexpr int tries = 3;
    for (int i = 0; i < tries; ++i) {
        const auto traced = attempt(kernel, scene, call, made);
        if (!traced) return tl::unexpected(traced.error());
        if (*traced) return {};
        if (const auto brought = upload(scene); !brought) return brought;
    }
    return tl::unexpected(
        remember(scene, no_room("other scenes evicted this one before its call")));
}

tl::expected<bool, Unavailable> Supervisor::attempt(const Kernel& kernel, const Snapshot& scene,
                                                    const TraceCall& call,
                                                    const PinholeRays* made) {
    if (const auto refusal = unavailable_reason(kernel, scene)) return tl::unexpected(*refusal);
    const auto lease = take_slot();
    if (!lease) return tl::unexpected(lease.error());
    auto traced = trace_on(*lease->process(), lease->slot(), kernel, scene, call, made,
                           milliseconds(limits_.cuda_call_ms_max));
    if (!traced && traced.error().lost)
        return tl::unexpected(lose(lease->process(), scene, std::move(traced.error())));
    return traced;
}

// Takes the turn before the slot, so that calls of scenes on the device go on during the wait.
tl::expected<void, Unavailable> Supervisor::upload(const Snapshot& scene) {
    const auto turn = take_turn(scene);
    if (!turn) return tl::unexpected(turn.error());
    if (!*turn) return {};
    const auto lease = take_slot();
    if (!lease) return tl::unexpected(lease.error());
    auto loaded = load(*lease->process(), lease->slot(), scene);
    if (!loaded && loaded.error().lost)
        return tl::unexpected(lose(lease->process(), scene, std::move(loaded.error())));
    return loaded;
}

tl::expected<bool, Unavailable> Supervisor::trace_on(Process& process, std::uint32_t slot,
                                                     const Kernel& kernel, const Snapshot& scene,
                                                     const TraceCall& call, const PinholeRays* made,
                                                     milliseconds time_limit) {
    const auto variant = find_kernel(process.ready(), kernel);
    if (!variant) return tl::unexpected(Unavailable{no_kernel(kernel)});
    const std::uint64_t hits = std::uint64_t{call.ray_count} * call.hits_max;
    if (call.ray_count > process.shape().rays_max || hits > process.shape().hits_max)
        return tl::unexpected(Unavailable{"the call is larger than its slots"});

    Request request;
    request.scene = SceneText(scene.arena_id());
    request.variant = *variant;
    request.query = kernel.query;
    request.ray_count = call.ray_count;
    request.hits_max = call.hits_max;
    request.mask = call.mask;
    request.flags = call.flags;
    request.has_params = call.params != nullptr;
    if (request.has_params) std::copy_n(call.params, kernel.param_count, request.params);
    request.has_made = made != nullptr;
    const SlotMemory memory = process.memory(slot);
    if (made != nullptr)
        request.made = *made;
    else
        std::copy_n(call.rays, call.ray_count, memory.rays);

    const Result<Outcome> outcome = process.ask(slot, request, time_limit);
    if (outcome && outcome->verdict == Verdict::unknown_scene) return false;
    if (auto refusal = refusal_of(outcome, scene)) return tl::unexpected(std::move(*refusal));

    std::copy_n(memory.hits, hits, call.hits);
    if (kernel.query == query_multi)
        std::copy_n(memory.hit_counts, call.ray_count, call.hit_counts);
    // Validate the copy: the worker cannot change it any more.
    switch (validate_hits(call, scene.view(), kernel.query)) {
        case Answers::possible:
            break;
        case Answers::given_up:
            return tl::unexpected(Unavailable{"rays meet too much of the scene for it"});
        case Answers::impossible:
            return tl::unexpected(lost("it returned hits that are impossible in the scene"));
    }
    return true;
}

std::optional<Unavailable> Supervisor::refusal_of(const Result<Outcome>& outcome,
                                                  const Snapshot& scene) {
    if (!outcome) return lost(outcome.error().message);
    switch (outcome->verdict) {
        case Verdict::done:
            break;
        case Verdict::unknown_scene:
            return Unavailable{"it does not have the scene"};
        case Verdict::out_of_memory:
            return remember(scene, no_room(outcome->text.printable()));
        case Verdict::too_deep:
            return remember(
                scene, Unavailable{"its kernels do not take the scene: it is nested too deep"});
        case Verdict::refused:
            return Unavailable{outcome->text.printable()};
        case Verdict::lost:
            return lost(outcome->text.printable());
    }
    return std::nullopt;
}

tl::expected<void, Unavailable> Supervisor::load(Process& process, std::uint32_t slot,
                                                 const Snapshot& scene) {
    const auto outcome = device::upload(process, slot, scene, {budget_, metrics_, limits_});
    if (!outcome)
        return tl::unexpected(outcome.error().code == protocol::Code::resource_exhausted
                                  ? remember(scene, outcome.error())
                                  : outcome.error());
    if (auto refusal = refusal_of(*outcome, scene)) return tl::unexpected(std::move(*refusal));
    return {};
}

Supervisor::Refused& Supervisor::refused_locked(const Snapshot& scene) {
    if (refused_.size() >= refused_max) refused_.clear();
    return refused_[scene.arena_id()];
}

Unavailable Supervisor::remember(const Snapshot& scene, Unavailable refusal) {
    const std::lock_guard lock(mutex_);
    Refused& refused = refused_locked(scene);
    if (refused.until > Clock::now() + scene_pause) return refusal;
    refused.refusal = refusal;
    refused.until = Clock::now() + scene_pause;
    return refusal;
}

Unavailable Supervisor::lose(const ProcessPointer& process, const Snapshot& scene,
                             Unavailable refusal) {
    const std::lock_guard lock(mutex_);
    if (process_ != process) {
        // Keep the reason of the thread that noticed first: this one may have seen a consequence.
        if (state_ != State::up) refusal.reason = reason_;
        return refusal;
    }
    Refused& refused = refused_locked(scene);
    const Clock::time_point now = Clock::now();
    if (now - std::exchange(refused.lost, now) > loss_memory) refused.losses = 0;
    if (++refused.losses >= losses_max) {
        refused.refusal = refusal;
        refused.until = now + loss_pause;
    }
    lose_locked(refusal.reason);
    return refusal;
}

void Supervisor::lose_locked(std::string reason) {
    process_->kill();
    lost_ = std::exchange(process_, nullptr);
    state_ = State::down;
    reason_ = std::move(reason);
    absent_ = false;
    retry_at_ = Clock::now() + milliseconds(limits_.cuda_retry_ms);
    ++metrics_.cuda_faults;
    changed_.notify_all();
}

}  // namespace raynest::server::device
