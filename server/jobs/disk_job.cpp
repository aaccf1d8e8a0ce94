#include "server/jobs/disk_job.h"

#include <utility>

namespace raynest::server {
namespace {

class DiskJob final : public Job {
public:
    DiskJob(const Services& services, std::function<Reply<DiskChange>()> change)
        : services_(services),
          change_(std::move(change)) {}

    std::optional<Task> next() override {
        if (!change_) return std::nullopt;
        auto changed = std::exchange(change_, nullptr)();
        Task task;
        if (!changed) {
            task.run = [error = changed.error()](const Stop&) -> Reply<Frames> {
                return tl::unexpected(error);
            };
            return task;
        }
        answer_.push_back(std::move(changed->answer));
        task.pool = services_.disk;
        task.run = [write = std::move(changed->write)](const Stop&) -> Reply<Frames> {
            if (const auto written = write(); !written) return tl::unexpected(written.error());
            return Frames{};
        };
        return task;
    }
    [[nodiscard]] bool finished() const override { return !change_; }
    Frames farewell() override { return std::move(answer_); }

private:
    const Services& services_;
    std::function<Reply<DiskChange>()> change_;
    Frames answer_;
};

}  // namespace

std::unique_ptr<Job> disk_job(const Services& services, std::function<Reply<DiskChange>()> change) {
    return std::make_unique<DiskJob>(services, std::move(change));
}

}  // namespace raynest::server
