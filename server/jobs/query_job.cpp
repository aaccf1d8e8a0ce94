#include "server/jobs/query_job.h"

#include "protocol/answer.h"
#include "protocol/control.h"
#include "server/jobs/services.h"
#include "server/scheduling/inline_budget.h"

#include <algorithm>
#include <utility>
#include <vector>

namespace raynest::server {

std::uint64_t frame_bytes_max(const Caller& caller) {
    return std::min(answer_frame_bytes_max, caller.window_bytes / 2);
}

QueryJob::QueryJob(const Services& services, const Caller& caller, Plan plan, RaySource source)
    : ChunkedJob(services, caller, std::move(plan), source.rays(),
                 !source.has_points() && !source.motion()),
      source_(std::move(source)),
      input_(source_.sent(), source_.rays_per_point(), services.limits, services.budget,
             caller.principal),
      sweep_(source_.sweep()) {
    if (source_.motion())
        steps_.emplace(services_, plan_, *sweep_, source_.motion()->scene, source_.first(),
                       source_.rays(), principal_);
    if (source_.sent() == 0 && sweep_ == nullptr) queue_.add(0, source_.rays());
}

Frames QueryJob::greeting() {
    wire::StartedT message = started(plan_, services_.limits);
    message.rays = source_.rays();
    Frames frames;
    frames.push_back(protocol::answer(id_, message));
    return frames;
}

Reply<std::uint64_t> QueryJob::feed(protocol::Frame frame) {
    if (sweep_ != nullptr) return sweep_->feed(std::move(frame), services_.limits);
    if (source_.sent() == 0)
        return refuse(Code::invalid_field, "the daemon makes the rays of this query: send none");
    const std::uint64_t first = input_.received_rays();
    const auto rays = input_.feed(std::move(frame));
    if (!rays) return tl::unexpected(rays.error());
    queue_.add(first, *rays);
    return std::uint64_t{0};
}

std::optional<Task> QueryJob::next() {
    if (sweep_ != nullptr && !sweep_->is_made()) return sweep_->next();
    auto work = next_work();
    if (!work) return steps_ ? steps_->next() : std::nullopt;
    auto& [chunk, task] = *work;
    task.reply_bytes_max = reply_bytes(chunk.count);
    // The columns of a posed scene may have to sample its animation.
    if (!steps_ && plan_.scene.held->velocities == nullptr &&
        source_.rays() * plan_.hits_max <= inline_cost_max && plan_.has_small_trees() &&
        plan_.traversal != traversal_reference && plan_.is_local())
        task.inline_cost = chunk.count * plan_.hits_max;
    task.mergeable = mergeable(chunk);
    return std::move(task);
}

Reply<void> QueryJob::ended() {
    if (sweep_ != nullptr && !sweep_->is_made()) {
        sweep_->ended();
        if (sweep_->is_made() && !steps_) queue_.add(0, source_.rays());
    } else if (steps_) {
        steps_->ended(queue_);
    }
    return {};
}

Frames QueryJob::farewell() {
    wire::DoneT message = done();
    message.rows = rows();
    if (plan_.untraced) message.traversal = "none";
    if (steps_) message.notes.push_back(steps_->note());
    Frames frames;
    frames.push_back(protocol::answer(id_, message));
    return frames;
}

std::optional<Progress> QueryJob::progress() const {
    return Progress{queue_.answered(), source_.rays(), "tracing"};
}

void QueryJob::answered(const Chunk& chunk, std::uint64_t count) {
    if (source_.sent() != 0) input_.release(chunk.first, count);
    count_rays(plan_.untraced ? "null" : query_name(plan_.query), chunk, count);
    if (steps_) steps_->answered(chunk, count);
    queue_.answered(count);
}

std::shared_ptr<const Plan> QueryJob::plan_of(const Chunk& chunk) const {
    if (steps_) return steps_->plan_of(chunk);
    return {std::shared_ptr<const Plan>(), &plan_};
}

Traced<TracedRays> QueryJob::trace_rays_of(const Plan& plan, const Chunk& chunk, const Stop& stop,
                                           TraceBuffers& buffers, bool any_order) {
    if (!steps_) return source_.trace(plan, chunk, input_, stop, buffers, any_order);
    std::vector<std::uint64_t> numbers(chunk.count);
    steps_->order().numbers(chunk.first, numbers);
    return source_.trace(plan, chunk.backend, numbers, stop, buffers);
}

}  // namespace raynest::server
