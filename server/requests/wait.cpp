// WAIT: answers once a detached job has ended.
#include "protocol/answer.h"
#include "server/documents/job_info.h"
#include "server/requests/request.h"

#include <memory>
#include <utility>

namespace raynest::server {
namespace {

class WaitJob final : public Job {
public:
    WaitJob(const Services& services, const Caller& caller, DetachedJobs::Pointer awaited)
        : services_(services),
          id_(caller.request_id),
          awaited_(std::move(awaited)) {}

    std::optional<Task> next() override { return std::nullopt; }
    [[nodiscard]] bool finished() const override { return awaited_->ended(); }
    Frames farewell() override {
        Frames frames;
        frames.push_back(protocol::answer(id_, job_info(*awaited_, services_.admission)));
        return frames;
    }
    [[nodiscard]] std::optional<Progress> progress() const override {
        const JobRecord* running = services_.admission.find(awaited_->record().number);
        return running != nullptr && running->job != nullptr ? running->job->progress()
                                                             : std::nullopt;
    }

private:
    const Services& services_;
    const std::uint64_t id_;
    const DetachedJobs::Pointer awaited_;
};

}  // namespace

Reply<Answer> wait(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Wait>& message) {
    auto awaited = services.detached.find(message->job());
    if (!awaited) return tl::unexpected(awaited.error());
    JobSubmission accepted;
    accepted.kind = "wait";
    accepted.scene = (*awaited)->record().scene;
    accepted.deadline_ms = message->deadline_ms();
    accepted.job = std::make_unique<WaitJob>(services, caller, std::move(*awaited));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
