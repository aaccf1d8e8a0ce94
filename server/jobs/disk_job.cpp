#include "server/jobs/disk_job.h"

#include <utility>

namespace raynest::server {
namespace {

class DiskJob final : public Job {
public:
    DiskJob(const Services& services, std::function<Reply<WriteToDisk>()> change)
        : services_(services),
          change_(std::move(change)) {}

    std::optional<Task> next() override {
        if (!change_) return std::nullopt;
        auto write = std::exchange(change_, nullptr)();
        Task task;
        if (!write) {
            task.run = [error = write.error()](const Stop&) -> Reply<Frames> {
                return tl::unexpected(error);
            };
            return task;
        }
        task.pool = services_.disk;
        task.run = [this, write = std::move(*write)](const Stop&) -> Reply<Frames> {
            auto answer = write();
            if (!answer) return tl::unexpected(answer.error());
            answer_.push_back(std::move(*answer));
            return Frames{};
        };
        return task;
    }
    [[nodiscard]] bool finished() const override { return !change_; }
    Frames farewell() override { return std::move(answer_); }

private:
    const Services& services_;
    std::function<Reply<WriteToDisk>()> change_;
    Frames answer_;  ///< written by the task
};

}  // namespace

std::unique_ptr<Job> disk_job(const Services& services,
                              std::function<Reply<WriteToDisk>()> change) {
    return std::make_unique<DiskJob>(services, std::move(change));
}

}  // namespace raynest::server
