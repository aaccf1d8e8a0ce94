#include "server/jobs/explain_job.h"

#include "protocol/text.h"
#include "server/documents/scene_info.h"

#include <utility>

namespace raynest::server {

ExplainJob::ExplainJob(const Services& services, const Caller& caller, Plan plan,
                       std::string camera, Budget::Lease lease)
    : ChunkedJob(services, caller, std::move(plan), 1, false),
      camera_(clean_text(camera, services.limits.name_bytes_max)),
      lease_(std::move(lease)),
      payload_(services.limits, caller, "json") {
    queue_.add(0, 1);
}

Frames ExplainJob::greeting() {
    wire::StartedT message = started(plan_, services_.limits);
    message.camera = camera_;
    Frames frames;
    frames.push_back(*protocol::encode(id_, message));
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
    frames.push_back(*protocol::encode(id_, done()));
    return frames;
}

void ExplainJob::finish(const Chunk& chunk, Traversal traversal,
                        const JobStatistics::Counts& counts, const std::string& document) {
    payload_.set(json_payload(1, 1, document));
    statistics_.add(chunk.backend, traversal, counts);
    count_rays("explain", chunk, counts.rays);
    queue_.answered(1);
}

Reply<Budget::Lease> reserve_explanation(const Services& services, const Caller& caller,
                                         std::uint64_t entries, std::string_view fewer) {
    const std::uint64_t bytes = explained_head_bytes + entries * explained_entry_bytes;
    auto lease = services.peers.reserve(bytes, caller.principal);
    if (lease) return std::move(*lease);
    return services.budget.refuse("the explanation", bytes, caller.principal, std::string(fewer));
}

JobSubmission accept_explanation(const Caller& caller, const Plan& plan, std::uint64_t bytes,
                                 std::string_view fewer) {
    JobSubmission accepted = accept(plan, "explain", 1);
    accepted.advice = fewer;
    accepted.answer_bytes = accepted.result_bytes = payload_answer_bytes(caller, bytes);
    return accepted;
}

Reply<void> check_pixel(const Pixel& pixel, std::uint32_t width, std::uint32_t height) {
    if (pixel[0] < width && pixel[1] < height) return {};
    return refuse(Code::invalid_field,
                  "pixel " + std::to_string(pixel[0]) + "," + std::to_string(pixel[1]) +
                      " lies outside of a picture of " + std::to_string(width) + "x" +
                      std::to_string(height) + "; pixels count from 0,0, the upper left corner");
}

}  // namespace raynest::server
