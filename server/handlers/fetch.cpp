// FETCH: sends the answer of a detached job, frame by frame, under the credit of the caller.
#include "server/handlers/handler.h"

#include <algorithm>
#include <cstring>
#include <memory>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint32_t retry_ms = 250;

protocol::Buffer copy(const protocol::Buffer& from) {
    protocol::Buffer to(from.size());
    if (from.size() != 0) std::memcpy(to.data(), from.data(), from.size());
    return to;
}

class FetchJob final : public Job {
public:
    FetchJob(const Caller& caller, DetachedJobs::Pointer source)
        : id_(caller.request_id),
          source_(std::move(source)) {}

    std::optional<Task> next() override {
        // Run one task at a time, so that frames leave in the order of the answer.
        if (running_ || next_ == source_->answer().size()) return std::nullopt;
        running_ = true;
        const protocol::Frame& frame = source_->answer()[next_++];
        Task task;
        task.reply_bytes_max = frame.header.bulk_bytes;
        task.run = [id = id_, &frame](const Stop&) {
            Frames frames(1);
            frames[0].header = frame.header;
            frames[0].header.request_id = id;
            frames[0].control = copy(frame.control);
            frames[0].bulk = copy(frame.bulk);
            return Reply<Frames>(std::move(frames));
        };
        return task;
    }
    Reply<void> ended() override {
        running_ = false;
        return {};
    }
    [[nodiscard]] bool finished() const override { return next_ == source_->answer().size(); }
    /// Returns nothing: the kept answer ends with its own DONE.
    Frames farewell() override {
        source_->set_fetched();
        return {};
    }
    [[nodiscard]] std::optional<Progress> progress() const override {
        return Progress{next_, source_->answer().size(), "fetching"};
    }

private:
    const std::uint64_t id_;
    const DetachedJobs::Pointer source_;
    std::size_t next_ = 0;
    bool running_ = false;
};

}  // namespace

Reply<Answer> fetch(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Fetch>& message) {
    auto source = services.detached.find(message->job());
    if (!source) return tl::unexpected(source.error());
    const DetachedJob& job = **source;
    const std::string name = "job " + std::to_string(message->job());
    if (!job.ended())
        return tl::unexpected(
            protocol::Error{Code::busy, name + " is not done yet; see `Wait`", retry_ms});
    if (job.error()) return tl::unexpected(*job.error());
    JobSubmission accepted;
    for (const protocol::Frame& frame : job.answer()) {
        // Refuse larger frames: a client may return credit only after half a window.
        if (frame.header.bulk_bytes > caller.window_bytes / 2)
            return refuse(Code::invalid_field,
                          name + " has frames of " + std::to_string(frame.header.bulk_bytes) +
                              " bytes: say Hello with window_bytes of twice as much");
        accepted.answer_bytes += frame.header.bulk_bytes;
    }
    accepted.kind = "fetch";
    accepted.scene = job.record().scene;
    accepted.deadline_ms = message->deadline_ms();
    accepted.job = std::make_unique<FetchJob>(caller, std::move(*source));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
