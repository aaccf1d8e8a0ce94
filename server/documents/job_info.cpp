#include "server/documents/job_info.h"

#include "protocol/control.h"
#include "server/ground/stop.h"

#include <algorithm>

namespace raynest::server {
namespace {

std::uint64_t milliseconds(Clock::duration time) {
    using std::chrono::milliseconds;
    return static_cast<std::uint64_t>(
        std::max<std::int64_t>(0, std::chrono::duration_cast<milliseconds>(time).count()));
}

/// Returns the time until `end`; 0 if there is no end.
std::uint64_t milliseconds_until(Clock::time_point end) {
    return end == Clock::time_point::max() ? 0 : milliseconds(end - Clock::now());
}

}  // namespace

wire::JobInfoT job_info(const JobRecord& record) {
    wire::JobInfoT info;
    info.job = record.number;
    info.owner = record.principal;
    info.kind = record.kind;
    info.detail = record.detail;
    info.scene = record.scene;
    info.state = "running";
    info.worker = record.worker;
    info.detached = record.detached;
    info.age_ms = milliseconds(Clock::now() - record.started);
    info.left_ms = milliseconds_until(record.deadline);
    if (record.job == nullptr) return info;
    if (const auto progress = record.job->progress()) {
        info.done = progress->done;
        info.total = progress->total;
        info.stage = progress->stage;
    }
    return info;
}

wire::JobInfoT job_info(const DetachedJob& job, const Admission& admission) {
    const JobRecord* running = admission.find(job.record().number);
    wire::JobInfoT info = job_info(running != nullptr ? *running : job.record());
    info.bytes = job.bytes();
    if (!job.ended()) return info;
    info.left_ms = milliseconds_until(job.expiry());
    info.state = "done";
    if (!job.error()) {
        if (const auto done = protocol::open<wire::Done>(job.answer().frames.back()))
            info.done = info.total = (*done)->rays();
        return info;
    }
    info.state = job.error()->code == Code::cancelled ? "cancelled" : "failed";
    info.code = static_cast<std::uint32_t>(job.error()->code);
    info.error = job.error()->message;
    return info;
}

}  // namespace raynest::server
