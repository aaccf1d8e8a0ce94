#include "server/jobs/unload_job.h"

#include "protocol/answer.h"
#include "server/store/scene_store.h"
#include "server/store/state_folder.h"

#include <utility>
#include <vector>

namespace raynest::server {
namespace {

class UnloadJob final : public Job {
public:
    UnloadJob(const Services& services, std::uint64_t request_id,
              std::function<Reply<wire::UnloadedT>()> unload)
        : services_(services),
          id_(request_id),
          unload_(std::move(unload)) {}

    std::optional<Task> next() override {
        if (!unload_) return std::nullopt;
        auto unloaded = std::exchange(unload_, nullptr)();
        std::vector<StoredScene> rows = services_.scenes.take_dropped();
        Task task;
        if (!unloaded) {
            task.run = [error = unloaded.error()](const Stop&) -> Reply<Frames> {
                return tl::unexpected(error);
            };
            return task;
        }
        unloaded_ = std::move(*unloaded);
        // Also for nothing: the memory that was freed may have held the last pin of a blob.
        task.pool = services_.disk;
        task.run = [this, rows = std::move(rows)](const Stop&) -> Reply<Frames> {
            if (const auto removed = services_.state->remove(rows); !removed)
                return refuse(Code::resource_exhausted,
                              removed.error().message + "; after a restart it is there again");
            return Frames{};
        };
        return task;
    }
    [[nodiscard]] bool finished() const override { return !unload_; }
    Frames farewell() override {
        Frames frames;
        frames.push_back(protocol::answer(id_, unloaded_));
        return frames;
    }

private:
    const Services& services_;
    const std::uint64_t id_;
    std::function<Reply<wire::UnloadedT>()> unload_;
    wire::UnloadedT unloaded_;
};

}  // namespace

std::unique_ptr<Job> unload_job(const Services& services, std::uint64_t request_id,
                                std::function<Reply<wire::UnloadedT>()> unload) {
    return std::make_unique<UnloadJob>(services, request_id, std::move(unload));
}

}  // namespace raynest::server
