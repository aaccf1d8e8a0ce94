#include "server/scheduling/runner.h"

#include "protocol/answer.h"
#include "protocol/control.h"
#include "protocol/text.h"
#include "server/ground/io_turn.h"
#include "server/ground/refusals.h"
#include "server/scheduling/disposal.h"
#include "server/scheduling/job_log.h"

#include <algorithm>
#include <iterator>
#include <new>
#include <utility>

namespace raynest::server {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds tick_period{250};

}  // namespace

Reply<std::uint64_t> Job::feed(protocol::Frame /*frame*/) {
    return refuse(Code::bad_frame, "this request takes no data");
}

Runner::ActivePointer Runner::find(std::uint64_t id) const {
    const auto found = std::find_if(jobs_.begin(), jobs_.end(),
                                    [&](const ActivePointer& active) { return active->id == id; });
    return found == jobs_.end() ? nullptr : *found;
}

template <class Step>
void Runner::guarded(Active& active, Step step) {
    const RequestScope scope(active.tag);
    const WorksForPeer working(works_);
    try {
        step();
    } catch (const std::bad_alloc&) {
        stop(active, {Code::resource_exhausted, "", 0});
    }
}

bool Runner::knows(std::uint64_t id) const {
    return find(id) != nullptr;
}

Reply<Admission::Slot> Runner::enter(JobRecord record) {
    const WorksForPeer working(works_);
    auto slot = context_.admission.enter(std::move(record));
    if (slot) return slot;
    const auto whose = context_.admission.blocking_limit(principal_);
    if (whose && context_.peers.make_room(Resource::jobs, principal_, 1, *whose))
        slot = context_.admission.enter(std::move(record));
    if (!slot) context_.metrics.count<&Metrics::jobs_refused>(principal_);
    return slot;
}

Reply<Admission::Slot> Runner::enter_parked(std::uint16_t message_type, Clock::time_point deadline,
                                            std::function<void()> cancel) {
    JobRecord record;
    record.principal = principal_;
    record.kind = "parked";
    record.detail = protocol::message_name(message_type);
    record.started = Clock::now();
    record.deadline = deadline;
    record.cancel = std::move(cancel);
    return enter(std::move(record));
}

Reply<std::uint64_t> Runner::start(std::uint64_t id, JobSubmission accepted) {
    const WorksForPeer working(works_);
    const Clock::time_point now = Clock::now();
    const Clock::time_point deadline = deadline_after(now, accepted.deadline_ms);
    JobRecord record;
    record.principal = principal_;
    record.kind = std::move(accepted.kind);
    record.detail = std::move(accepted.detail);
    record.worker = std::move(accepted.worker);
    record.scene = std::move(accepted.scene);
    record.rays = accepted.rays;
    record.detached = accepted.detach;
    record.started = now;
    record.deadline = deadline;
    record.job = accepted.job.get();
    record.cancel = [runner = weak_from_this(), id] {
        if (const auto self = runner.lock()) self->cancel(id);
    };
    auto slot = enter(std::move(record));
    if (!slot) return tl::unexpected(slot.error());
    const std::uint64_t window = context_.limits.window_bytes;
    const std::uint64_t input_bytes = std::min(accepted.input_bytes, window);
    const std::uint64_t answer_bytes = std::min(accepted.answer_bytes, window - answers_.bytes());
    auto input = context_.peers.reserve(input_bytes, principal_);
    auto answers = context_.peers.reserve(answer_bytes, principal_);
    if (!input || !answers) {
        context_.metrics.count<&Metrics::jobs_refused>(principal_);
        return context_.budget.refuse("the data and answers of the request",
                                      input_bytes + answer_bytes, principal_,
                                      "wait for your other requests, or start raynestd with a "
                                      "larger --memory");
    }
    answers_.merge(std::move(*answers));
    const std::uint64_t number = slot->number();
    auto active = std::make_shared<Active>(id, std::move(accepted.job), deadline);
    active->slot = std::move(*slot);
    active->input = std::make_shared<Budget::Lease>(std::move(*input));
    active->priority = accepted.priority;
    active->started = now;
    active->next_progress = now + tick_period;
    active->credit = window_bytes_;
    active->input_credit = context_.limits.window_bytes;
    jobs_.push_back(active);
    context_.metrics.count<&Metrics::jobs_started>(principal_);
    guarded(*active, [&] {
        active->parked = active->job->prepare();
        if (active->parked)
            submit(active, *std::exchange(active->parked, std::nullopt));
        else
            greet(*active);
    });
    pump(active);
    return number;
}

void Runner::greet(Active& active) {
    active.prepared = true;
    for (protocol::Frame& frame : active.job->greeting()) sink_->send(std::move(frame));
}

std::shared_ptr<Budget::Lease> Runner::admit(std::uint64_t id, std::uint64_t bytes) {
    const ActivePointer active = find(id);
    if (active == nullptr || active->error || bytes > active->input_credit) return nullptr;
    // The credit is a whole window, while less was reserved for a request that announced less.
    const std::uint64_t window = context_.limits.window_bytes;
    const std::uint64_t unread = window - std::min(window, active->input_credit + active->returned);
    Budget::Lease& input = *active->input;
    if (unread + bytes <= input.bytes()) return active->input;
    const WorksForPeer working(works_);
    const std::uint64_t more = unread + bytes - input.bytes();
    auto lease = context_.peers.reserve(more, principal_);
    if (!lease) {
        stop(*active, context_.budget
                          .refuse("a frame beyond the data that the request announced", more,
                                  principal_, "try later")
                          .value());
        pump(active);
        return nullptr;
    }
    input.merge(std::move(*lease));
    return active->input;
}

void Runner::feed(protocol::Frame frame) {
    const ActivePointer active = find(frame.header.request_id);
    if (active == nullptr || active->error) return;
    const std::uint64_t bytes = frame.header.bulk_bytes;
    // Fail also if the bulk part is missing: it was skipped because it exceeded the credit at that
    // time, even if more was granted since.
    if (bytes > active->input_credit || frame.bulk.size() < bytes) {
        stop(*active, {Code::limit_exceeded,
                       "a frame of " + std::to_string(bytes) +
                           " bulk bytes is more than the request may send: a credit of "
                           "window_bytes = " +
                           std::to_string(context_.limits.window_bytes) +
                           ", rays in frames of chunk_rays_max = " +
                           std::to_string(context_.limits.chunk_rays_max) +
                           "; wait for credit and send smaller frames",
                       0});
        return pump(active);
    }
    active->input_credit -= bytes;
    guarded(*active, [&] {
        const Reply<std::uint64_t> free = active->job->feed(std::move(frame));
        if (free)
            return_input(*active, *free);
        else
            stop(*active, free.error());
    });
    pump(active);
}

void Runner::grant(std::uint64_t id, std::uint64_t bytes) {
    const ActivePointer active = find(id);
    if (active == nullptr) return;
    const std::uint64_t most = context_.limits.window_bytes_max;
    active->credit = std::min(most, active->credit + std::min(most, bytes));
    pump(active);
}

void Runner::cancel(std::uint64_t id) {
    fail(id, {Code::cancelled, "", 0});
}

void Runner::cancel_all() {
    fail_all({Code::cancelled, "", 0});
}

void Runner::fail(std::uint64_t id, const protocol::Error& error) {
    const ActivePointer active = find(id);
    if (active == nullptr) return;
    stop(*active, error);
    pump(active);
}

void Runner::fail_all(const protocol::Error& error) {
    const std::list<ActivePointer> jobs = jobs_;
    for (const ActivePointer& active : jobs) fail(active->id, error);
}

bool Runner::needs_client(std::uint64_t id) const {
    const ActivePointer active = find(id);
    return active != nullptr && (active->error || active->job->needs_input());
}

void Runner::pump() {
    // Rotate the order of jobs so that each gets the first share of the send window in turn.
    if (!jobs_.empty()) jobs_.splice(jobs_.end(), jobs_, jobs_.begin());
    const std::list<ActivePointer> jobs = jobs_;
    for (const ActivePointer& active : jobs) pump(active);
    shrink_answers();
}

void Runner::pump(const ActivePointer& active) {
    guarded(*active, [&] {
        while (sink_ != nullptr && !active->error && active->prepared) {
            if (!active->parked) active->parked = active->job->next();
            if (!active->parked || !may_start(*active, *active->parked)) break;
            Task task = *std::exchange(active->parked, std::nullopt);
            if (task.inline_cost == 0 || !active->tasks.empty() || !run_inline(*active, task))
                submit(active, std::move(task));
        }
    });
    const bool done =
        active->error || (active->prepared && !active->parked && active->job->finished());
    if (active->tasks.empty() && done) finish(active);
}

bool Runner::run_inline(Active& active, const Task& task) {
    if (!context_.inline_budget.enter(task.inline_cost, context_.post)) return false;
    const InlineStop stop;
    auto reply = run_guarded(active.stop, [&] { return task.run(stop); });
    if (!reply && reply.error().code == Code::cancelled) {
        context_.inline_budget.end();
        return false;
    }
    take_answer(active, std::move(reply));
    return true;
}

bool Runner::may_start(const Active& active, const Task& task) const {
    const FairThreadPool& pool = pool_of(task);
    const auto there = std::ranges::count(active.tasks, &pool, &Outstanding::pool);
    // Allow one task more than there are threads, so that no thread waits for the io thread.
    if (static_cast<std::size_t>(there) > pool.threads()) return false;
    if (task.reply_bytes_max > active.credit - active.reserved) return false;
    const std::uint64_t waiting = in_flight_bytes_ + sink_->backlog();
    return task.reply_bytes_max == 0 || waiting == 0 ||
           waiting + task.reply_bytes_max <= context_.limits.window_bytes;
}

bool Runner::waits_for_client() const {
    return leaving_ == 0 && works_ == 0 &&
           std::all_of(jobs_.begin(), jobs_.end(), [](const ActivePointer& active) {
               return !active->error && active->tasks.empty() &&
                      (active->parked || active->job->needs_input());
           });
}

std::uint64_t Runner::held_bytes() const {
    std::uint64_t bytes = answers_.bytes();
    for (const ActivePointer& active : jobs_)
        bytes += active->input->bytes() + active->job->held_bytes();
    return bytes;
}

void Runner::submit(const ActivePointer& active, Task task) {
    std::list<Outstanding> submitted(1);
    const auto place = submitted.begin();
    place->reserved = task.reply_bytes_max;
    FairThreadPool& pool = pool_of(task);
    place->pool = &pool;
    const bool mergeable = task.mergeable != nullptr;
    auto dispatched = std::make_shared<DispatchedTask>(
        DispatchedTask{{active, &active->stop},
                       std::move(task),
                       [self = shared_from_this(), active, place](Reply<Frames> reply) {
                           self->task_ended(active, place, std::move(reply));
                       }});
    if (mergeable) {
        place->try_dequeue =
            context_.coalescer.add({pool, context_.post, context_.metrics}, principal_,
                                   active->priority, std::move(dispatched));
    } else {
        const auto number = std::make_shared<std::uint64_t>();
        place->try_dequeue = [&pool, principal = principal_, number] {
            return pool.change(principal, *number, [] { return false; });
        };
        *number =
            dispatch(pool, principal_, active->priority, context_.post, std::move(dispatched));
    }
    active->reserved += place->reserved;
    in_flight_bytes_ += place->reserved;
    active->tasks.splice(active->tasks.end(), submitted);
}

void Runner::task_ended(const ActivePointer& active, std::list<Outstanding>::iterator task,
                        Reply<Frames> reply) {
    IoTurn::does("end of a task");
    forget(*active, task);
    if (sink_ == nullptr) return finish(active);
    take_answer(*active, std::move(reply));
    pump(active);
}

void Runner::forget(Active& active, std::list<Outstanding>::iterator task) {
    active.reserved -= task->reserved;
    in_flight_bytes_ -= task->reserved;
    active.tasks.erase(task);
}

void Runner::take_answer(Active& active, Reply<Frames> reply) {
    guarded(active, [&] {
        if (reply && !active.error && !active.prepared) {
            greet(active);
        } else if (reply && !active.error) {
            for (protocol::Frame& frame : *reply) {
                active.credit -= std::min(active.credit, frame.header.bulk_bytes);
                sink_->send(std::move(frame));
            }
            return_input(active, active.job->take_freed_input());
            if (const Reply<void> taken = active.job->ended(); !taken) stop(active, taken.error());
        } else if (!reply) {
            stop(active, reply.error());
        }
    });
}

void Runner::return_input(Active& active, std::uint64_t bytes) {
    active.returned += bytes;
    // Grant a quarter of the window at a time: few messages, and the client never waits for one.
    if (active.returned < context_.limits.window_bytes / 4) return;
    wire::CreditT credit;
    credit.bytes = std::exchange(active.returned, 0);
    active.input_credit += credit.bytes;
    sink_->send(protocol::answer(active.id, credit));
}

void Runner::stop(Active& active, protocol::Error error) {
    if (!active.error) {
        active.error = std::move(error);
        active.stopped = Clock::now();
    }
    active.parked.reset();
    active.stop.request();
    // Drop tasks that no worker has started, and release their reservations.
    for (auto task = active.tasks.begin(); task != active.tasks.end();) {
        const auto next = std::next(task);
        if (task->try_dequeue()) forget(active, task);
        task = next;
    }
}

void Runner::finish(const ActivePointer& active) {
    if (!active->tasks.empty()) return;
    const RequestScope scope(active->tag);
    jobs_.remove(active);
    Frames last = conclude(*active);
    if (active->job->held_bytes() < disposed_bytes_min || !destroy_elsewhere(active, last))
        leave(*active, std::move(last));
}

Frames Runner::conclude(Active& active) {
    context_.metrics.count<&Metrics::jobs_ended>(principal_);
    if (const JobRecord* record = context_.admission.find(active.slot.number())) {
        log_job(*record, Clock::now(), active.error);
        if (active.error && record->kind == "load")
            context_.metrics.count<&Metrics::scenes_refused>(principal_);
    }
    const std::chrono::duration<double> took = Clock::now() - active.started;
    context_.admission.record(took);
    context_.metrics.job_seconds.add(took.count());
    Frames last;
    if (!active.error) context_.metrics.count<&Metrics::jobs_done>(principal_);
    if (sink_ != nullptr && !active.error) guarded(active, [&] { last = active.job->farewell(); });
    if (active.error) {
        const Code code = active.error->code;
        if (code == Code::cancelled)
            context_.metrics.count<&Metrics::jobs_cancelled>(principal_);
        else
            context_.metrics.count<&Metrics::jobs_failed>(principal_);
        if (code == Code::cancelled || code == Code::deadline)
            context_.metrics.cancel_seconds.add(
                std::chrono::duration<double>(Clock::now() - active.stopped).count());
        if (code == Code::deadline)
            ++context_.metrics.deadlines_passed;
        else if (code != Code::cancelled)
            ++refusals_of(context_.metrics, code);
    }
    return last;
}

bool Runner::destroy_elsewhere(const ActivePointer& active, Frames& last) {
    try {
        const auto kept = std::make_shared<Frames>();
        std::function<void()> end = [self = shared_from_this(), active, kept] {
            IoTurn::does("end of a job");
            --self->leaving_;
            self->leave(*active, std::move(*kept));
        };
        std::shared_ptr<Job> job = std::move(active->job);
        kept->swap(last);
        try {
            context_.compute.submit(
                principal_, active->priority,
                [job = std::move(job), end = std::move(end), &post = context_.post]() mutable {
                    job.reset();
                    post_surely(post, end);
                });
        } catch (const std::bad_alloc&) {
            last.swap(*kept);
            return false;
        }
    } catch (const std::bad_alloc&) {
        return false;
    }
    context_.admission.forget_job(active->slot.number());
    ++leaving_;
    return true;
}

void Runner::leave(Active& active, Frames last) {
    // Free the job's memory together with its slot, not when a worker drops the last reference.
    const RequestScope scope(active.tag);
    active.slot = {};
    active.job.reset();
    active.input.reset();
    if (sink_ != nullptr && !active.error)
        guarded(active, [&] {
            for (protocol::Frame& frame : last) sink_->send(std::move(frame));
        });
    if (sink_ != nullptr && active.error)
        sink_->send(protocol::encode_error(active.id, for_client(*active.error), false));
    shrink_answers();
}

void Runner::shrink_answers() {
    if (!jobs_.empty()) return;
    const std::uint64_t waiting = sink_ == nullptr ? 0 : sink_->backlog();
    answers_.shrink(std::min(answers_.bytes(), waiting));
}

void Runner::tick(Clock::time_point now) {
    const std::list<ActivePointer> jobs = jobs_;
    for (const ActivePointer& active : jobs) {
        if (!active->error && now >= active->stop.deadline()) {
            stop(*active, deadline_error());
            pump(active);
        } else if (active->prepared && now >= active->next_progress) {
            active->next_progress = now + tick_period;
            // Send no progress to a client that has not read everything yet.
            if (const auto progress = active->job->progress();
                progress && !active->error && sink_->backlog() == 0) {
                wire::ProgressT message;
                message.done = progress->done;
                message.total = progress->total;
                message.stage = progress->stage;
                message.samples = progress->samples;
                message.noise = progress->noise;
                message.left_ms = progress->left_ms;
                sink_->send(protocol::answer(active->id, message));
            }
            // Pump: the job may have waited for something other than its client.
            pump(active);
        }
    }
}

Clock::time_point Runner::next_tick() const {
    Clock::time_point next = Clock::time_point::max();
    for (const ActivePointer& active : jobs_)
        next = std::min({next, active->error ? Clock::time_point::max() : active->stop.deadline(),
                         active->next_progress});
    return next;
}

void Runner::abandon(const protocol::Error& why) {
    sink_ = nullptr;
    // Move the list: this must not allocate memory.
    const std::list<ActivePointer> jobs = std::move(jobs_);
    for (const ActivePointer& active : jobs) {
        stop(*active, why);
        finish(active);
    }
}

}  // namespace raynest::server
