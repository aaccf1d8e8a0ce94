// FETCH: sends the answer of a detached job, frame by frame, under the credit of the caller. A job
// that still refines a picture has a latest one, which is sent with a DONE that says so.
#include "protocol/answer.h"
#include "server/requests/request.h"
#include "server/scheduling/detached.h"

#include <cstring>
#include <list>
#include <memory>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint32_t retry_ms = 250;

protocol::Buffer copy_bytes(const protocol::Buffer& from) {
    protocol::Buffer to(from.size());
    if (from.size() != 0) std::memcpy(to.data(), from.data(), from.size());
    return to;
}

class FetchJob final : public Job {
public:
    FetchJob(const Caller& caller, DetachedJobs::Pointer source)
        : id_(caller.request_id),
          source_(std::move(source)),
          preview_(source_->ended() ? nullptr : source_->preview()),
          next_(frames().begin()) {}

    Frames greeting() override {
        Frames frames;
        // The answer of a running job begins with STARTED, and grows.
        if (preview_ != nullptr) frames.push_back(copy(source_->answer().frames.front()));
        return frames;
    }
    std::optional<Task> next() override {
        // Run one task at a time, so that frames leave in the order of the answer.
        if (running_ || next_ == frames().end()) return std::nullopt;
        running_ = true;
        ++sent_;
        const protocol::Frame& frame = *next_++;
        Task task;
        task.reply_bytes_max = frame.header.bulk_bytes;
        task.run = [this, &frame](const Stop&) {
            Frames copies;
            copies.push_back(copy(frame));
            return Reply<Frames>(std::move(copies));
        };
        return task;
    }
    Reply<void> ended() override {
        running_ = false;
        return {};
    }
    [[nodiscard]] bool finished() const override { return next_ == frames().end(); }
    /// Returns nothing for a job that has ended: the kept answer ends with its own DONE.
    Frames farewell() override {
        if (preview_ == nullptr) {
            source_->set_fetched();
            return {};
        }
        wire::DoneT done;
        done.incomplete = true;
        if (const auto picture = protocol::open<wire::Payload>(frames().front()))
            done.samples = (*picture)->samples();
        done.notes.push_back("job " + std::to_string(source_->record().number) +
                             " goes on: this is its picture so far");
        Frames frames;
        frames.push_back(protocol::answer(id_, done));
        return frames;
    }
    [[nodiscard]] std::optional<Progress> progress() const override {
        return Progress{sent_, frames().size(), "fetching"};
    }

private:
    [[nodiscard]] const std::list<protocol::Frame>& frames() const {
        return preview_ != nullptr ? preview_->frames : source_->answer().frames;
    }
    [[nodiscard]] protocol::Frame copy(const protocol::Frame& frame) const {
        protocol::Frame twin;
        twin.header = frame.header;
        twin.header.request_id = id_;
        twin.control = copy_bytes(frame.control);
        twin.bulk = copy_bytes(frame.bulk);
        return twin;
    }

    const std::uint64_t id_;
    const DetachedJobs::Pointer source_;
    const std::shared_ptr<const DetachedJob::Answer> preview_;
    std::list<protocol::Frame>::const_iterator next_;  ///< the first frame that was not sent yet
    std::uint64_t sent_ = 0;
    bool running_ = false;
};

}  // namespace

Reply<Answer> fetch(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Fetch>& message) {
    auto source = services.detached.find(message->job());
    if (!source) return tl::unexpected(source.error());
    const DetachedJob& job = **source;
    const std::string name = "job " + std::to_string(message->job());
    if (!job.ended() && job.preview() == nullptr)
        return tl::unexpected(
            protocol::Error{Code::busy, name + " is not done yet; see `Wait`", retry_ms});
    if (job.error()) return tl::unexpected(*job.error());
    JobSubmission accepted;
    const DetachedJob::Answer& answer = job.ended() ? job.answer() : *job.preview();
    // Refuse larger frames: a client may return credit only after half a window.
    if (answer.largest_bulk > caller.window_bytes / 2)
        return refuse(Code::invalid_field,
                      name + " has frames of " + std::to_string(answer.largest_bulk) +
                          " bytes: say Hello with window_bytes of twice as much");
    accepted.answer_bytes = answer.bulk_bytes;
    accepted.kind = "fetch";
    accepted.scene = job.record().scene;
    accepted.deadline_ms = message->deadline_ms();
    accepted.job = std::make_unique<FetchJob>(caller, std::move(*source));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
