#include "server/scheduling/detached.h"

#include "protocol/control.h"
#include "protocol/text.h"
#include "server/scheduling/disposal.h"

#include <algorithm>
#include <utility>

namespace raynest::server {
namespace {

/// Bytes reserved for the record, headers and control messages of an answer.
constexpr std::uint64_t base_bytes = 16ULL << 10;

/// Advice for an answer that is too large to keep; follows the advice to ask for less.
constexpr const char* not_kept = ", do not detach (an attached answer is not kept)";

template <class Table>
bool is(const protocol::Frame& frame) {
    return frame.header.type == static_cast<std::uint16_t>(protocol::message_of<Table>);
}

}  // namespace

DetachedJob::DetachedJob(const JobContext& context, JobRecord record, Principal owner,
                         Budget::Lease room, MoreRoom more_room)
    : context_(context),
      record_(std::move(record)),
      owner_(std::move(owner)),
      room_(std::move(room)),
      more_room_(std::move(more_room)),
      runner_(std::make_shared<Runner>(context, static_cast<Sink&>(*this), record_.principal)) {
    // Grant unlimited credit: the answer is limited by its room in memory, not by a window.
    runner_->set_window(~std::uint64_t{0});
}

void DetachedJob::Answer::add(protocol::Frame frame) {
    frame_bytes += waiting_frame_bytes + frame.header.frame_bytes();
    bulk_bytes += frame.header.bulk_bytes;
    largest_bulk = std::max(largest_bulk, frame.header.bulk_bytes);
    frames.push_back(std::move(frame));
}

DetachedJob::~DetachedJob() {
    runner_->abandon();
    drop(answer_);
    drop(arriving_);
}

void DetachedJob::drop(Answer& answer) noexcept {
    Answer dropped = std::exchange(answer, {});
    if (dropped.frame_bytes >= disposed_bytes_min)
        dispose(context_.compute, record_.principal, std::move(dropped));
}

Clock::time_point DetachedJob::expiry() const {
    return ended() ? ended_ + std::chrono::milliseconds(context_.limits.result_ms_max)
                   : Clock::time_point::max();
}

void DetachedJob::send(protocol::Frame frame) {
    if (ended() || is<wire::Progress>(frame)) return;
    if (is<wire::Credit>(frame)) {
        if (feeder_ != nullptr) feeder_->send(std::move(frame));
        return;
    }
    if (is<wire::Error>(frame)) {
        const auto error = protocol::open<wire::Error>(frame);
        end(protocol::Error{static_cast<Code>((*error)->code()),
                            std::string(protocol::text((*error)->message())), 0});
        if (feeder_ != nullptr) feeder_->send(std::move(frame));
        return;
    }
    const std::uint64_t bytes = kept_bytes() + waiting_frame_bytes + frame.header.frame_bytes();
    if (bytes > room_.bytes()) {
        auto more = more_room_(bytes - room_.bytes());
        if (!more) {
            end(more.error());
            if (feeder_ != nullptr)
                feeder_->send(protocol::encode_error(frame.header.request_id, *error_, false));
            // Post the cancel: the runner is in the middle of sending this frame.
            context_.post([runner = runner_] { runner->cancel_all(); });
            return;
        }
        room_.merge(std::move(*more));
    }
    if (is<wire::Payload>(frame)) {
        const auto picture = protocol::open<wire::Payload>(frame);
        if (picture && !(*picture)->last()) {
            const std::uint64_t offset = (*picture)->offset();
            const std::uint64_t end = offset + picture->blocks.at(0).bytes.size();
            return keep_preview(std::move(frame), offset == 0, end == (*picture)->total());
        }
    }
    const bool done = is<wire::Done>(frame);
    answer_.add(std::move(frame));
    if (done) end(std::nullopt);
}

void DetachedJob::keep_preview(protocol::Frame frame, bool begins, bool ends) {
    if (begins) drop(arriving_);
    arriving_.add(std::move(frame));
    if (!ends) return;
    preview_ = share_disposable(context_.compute, record_.principal, std::exchange(arriving_, {}));
}

void DetachedJob::end(std::optional<protocol::Error> error) {
    ended_ = Clock::now();
    error_ = std::move(error);
    if (error_) drop(answer_);
    drop(arriving_);
    preview_.reset();
    // Return the memory that was reserved for the worst case or for an answer that failed.
    room_.shrink(std::min(room_.bytes(), base_bytes + answer_.frame_bytes));
}

Reply<DetachedJobs::Pointer> DetachedJobs::start(const Principal& owner, std::uint64_t request_id,
                                                 JobSubmission accepted, Sink* feeder) {
    const std::string& principal = owner.id;
    const auto kept = [&] {
        return std::count_if(jobs_.begin(), jobs_.end(), [&](const auto& job) {
            return job.second->record().principal == principal;
        });
    };
    const std::uint64_t most = context_.limits.principal_results_max;
    while (static_cast<std::uint64_t>(kept()) >= most)
        if (!drop_fetched(principal))
            return refuse(Code::quota, principal + " keeps " + std::to_string(most) +
                                           " detached jobs, as many as --principal-results-max "
                                           "allows; fetch or cancel a finished one");
    const std::uint64_t bytes = base_bytes + accepted.result_bytes;
    const std::string advice = accepted.advice;
    auto room = make_room(principal, bytes, advice);
    if (!room && room.error().code == Code::resource_exhausted) {
        context_.peers.make_memory(bytes, principal, Use::lasting);
        room = make_room(principal, bytes, advice);
    }
    if (!room) return tl::unexpected(room.error());
    accepted.answer_bytes = 0;  // `room` already covers the answer
    JobRecord record;
    record.principal = principal;
    record.kind = accepted.kind;
    record.detail = accepted.detail;
    record.worker = accepted.worker;
    record.scene = accepted.scene;
    record.started = Clock::now();
    record.detached = true;
    Principal admitted = owner;
    admitted.page_login = 0;
    auto job = std::make_shared<DetachedJob>(context_, std::move(record), std::move(admitted),
                                             std::move(*room),
                                             [this, principal, advice](std::uint64_t more) {
                                                 return make_room(principal, more, advice);
                                             });
    job->set_feeder(feeder);
    const auto number = job->runner().start(request_id, std::move(accepted));
    job->set_feeder(nullptr);
    if (!number) return tl::unexpected(number.error());
    job->record_.number = *number;
    jobs_.emplace(*number, job);
    changed_();
    return job;
}

Reply<Budget::Lease> DetachedJobs::make_room(const std::string& principal, std::uint64_t bytes,
                                             const std::string& advice) {
    const std::uint64_t most = context_.limits.principal_result_bytes_max;
    const auto kept = [&] {
        std::uint64_t sum = 0;
        for (const auto& [number, job] : jobs_)
            if (job->record().principal == principal) sum += job->bytes();
        return sum;
    };
    while (bytes > most || kept() > most - bytes)
        if (bytes > most || !drop_fetched(principal))
            return refuse(
                Code::quota,
                "the answer needs " + protocol::bytes_text(bytes) + " more, " + principal +
                    " keeps " + protocol::bytes_text(kept()) +
                    ", the limit is --principal-result-bytes-max " + std::to_string(most) + "; " +
                    (bytes > most ? "" : "fetch or cancel a finished job, ") + advice + not_kept +
                    ", or start raynestd with a larger --principal-result-bytes-max");
    auto room = context_.budget.reserve(bytes, principal, Use::lasting);
    while (!room && drop_fetched(principal))
        room = context_.budget.reserve(bytes, principal, Use::lasting);
    if (!room)
        return context_.budget.refuse("the answer", bytes, principal,
                                      "fetch or cancel a finished job, " + advice + not_kept +
                                          ", or start raynestd with a larger --memory");
    return std::move(*room);
}

bool DetachedJobs::drop_fetched(const std::string& principal) {
    auto oldest = jobs_.end();
    for (auto job = jobs_.begin(); job != jobs_.end(); ++job) {
        const DetachedJob& candidate = *job->second;
        if (!candidate.fetched_ || candidate.record_.principal != principal) continue;
        if (oldest == jobs_.end() || candidate.ended_ < oldest->second->ended_) oldest = job;
    }
    if (oldest == jobs_.end()) return false;
    jobs_.erase(oldest);
    return true;
}

Reply<DetachedJobs::Pointer> DetachedJobs::find(std::uint64_t number) const {
    const auto found = jobs_.find(number);
    if (found == jobs_.end()) return tl::unexpected(unknown(number));
    return found->second;
}

protocol::Error DetachedJobs::unknown(std::uint64_t number) const {
    return {Code::job_unknown,
            "there is no job " + std::to_string(number) +
                ", or its answer is gone: one is kept for " +
                std::to_string(context_.limits.result_ms_max / 1000) +
                " s, and one that was fetched gives way when room is needed; see `Jobs`",
            0};
}

void DetachedJobs::cancel(std::uint64_t number) {
    const auto found = jobs_.find(number);
    if (found == jobs_.end()) return;
    const Pointer job = found->second;
    jobs_.erase(found);
    job->runner().cancel_all();
}

void DetachedJobs::stop_running() {
    for (const auto& [number, job] : jobs_)
        job->runner().fail_all({Code::draining,
                                "job " + std::to_string(number) +
                                    " was ended by the daemon's shutdown; start it again",
                                0});
}

void DetachedJobs::end_unless(const std::function<bool(const Principal&)>& valid,
                              const protocol::Error& error) {
    const std::map<std::uint64_t, Pointer> jobs = jobs_;
    for (const auto& [number, job] : jobs)
        if (!job->ended() && !valid(job->owner())) job->runner().fail_all(error);
}

void DetachedJobs::tick(Clock::time_point now) {
    const std::map<std::uint64_t, Pointer> jobs = jobs_;
    for (const auto& [number, job] : jobs) {
        job->runner().tick(now);
        if (now >= job->expiry()) jobs_.erase(number);
    }
}

Clock::time_point DetachedJobs::next_tick() const {
    Clock::time_point next = Clock::time_point::max();
    for (const auto& [number, job] : jobs_)
        next = std::min({next, job->runner().next_tick(), job->expiry()});
    return next;
}

}  // namespace raynest::server
