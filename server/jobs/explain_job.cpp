#include "server/jobs/explain_job.h"

#include "protocol/answer.h"
#include "protocol/text.h"
#include "server/documents/scene_info.h"
#include "server/jobs/services.h"

#include <utility>

namespace raynest::server {

ExplainJob::ExplainJob(const Services& services, const Caller& caller, Plan plan,
                       std::string camera, Budget::Lease lease)
    : ChunkedJob(services, caller, std::move(plan), 1, false),
      camera_(protocol::clean_text(camera, services.limits.name_bytes_max)),
      lease_(std::move(lease)),
      payload_(services.limits, caller, "json") {
    queue_.add(0, 1);
}

Frames ExplainJob::greeting() {
    wire::StartedT message = started(plan_, services_.limits);
    message.camera = camera_;
    Frames frames;
    frames.push_back(protocol::answer(id_, message));
    return frames;
}

std::optional<Task> ExplainJob::next() {
    if (explained_) return payload_.next();
    if (auto work = next_work()) return std::move(work->task);
    return std::nullopt;
}

Reply<void> ExplainJob::ended() {
    if (explained_)
        payload_.ended();
    else
        explained_ = queue_.all_answered();
    return {};
}

Frames ExplainJob::farewell() {
    Frames frames;
    wire::DoneT message = done();
    for (std::string& note : notes_) message.notes.push_back(std::move(note));
    frames.push_back(protocol::answer(id_, message));
    return frames;
}

void ExplainJob::finish(const Chunk& chunk, Traversal traversal,
                        const JobStatistics::Counts& counts, const std::string& document,
                        std::vector<std::string> notes) {
    notes_ = std::move(notes);
    payload_.set(json_payload(1, 1, document));
    statistics_.add(chunk.backend, 1U << traversal, counts);
    count_rays("explain", chunk, counts.rays);
    queue_.answered(1);
}

}  // namespace raynest::server
