// BACKUP: all stored scenes of one moment as one file (store/archive.h), while the daemon goes on.
#include "protocol/answer.h"
#include "server/ground/budget.h"
#include "server/ground/limited_log.h"
#include "server/jobs/payload_sender.h"
#include "server/jobs/services.h"
#include "server/requests/request.h"
#include "server/scheduling/fair_thread_pool.h"
#include "server/store/archive.h"
#include "server/store/state_folder.h"

#include <sys/stat.h>

#include <atomic>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

namespace raynest::server {
namespace {

/// Bytes of memory for each byte of the manifest: its rows, and what a scene is in the file.
constexpr std::uint64_t memory_per_manifest_byte = 12;

class BackupJob final : public Job {
public:
    BackupJob(const Services& services, const Caller& caller)
        : services_(services),
          caller_(caller),
          sender_(services.limits, caller, "tar") {}

    std::optional<Task> prepare() override {
        Task task;
        task.pool = services_.disk;
        task.run = [this](const Stop&) -> Reply<Frames> {
            if (auto made = make(); !made) return tl::unexpected(made.error());
            return Frames{};
        };
        return task;
    }
    Frames greeting() override {
        prepared_ = true;
        wire::StartedT message;
        message.notes = std::move(notes_);
        Frames frames;
        frames.push_back(protocol::answer(caller_.request_id, message));
        return frames;
    }
    std::optional<Task> next() override {
        auto task = sender_.next();
        if (task) task->pool = services_.disk;
        return task;
    }
    Reply<void> ended() override {
        sender_.ended();
        return {};
    }
    [[nodiscard]] bool finished() const override { return prepared_ && sender_.finished(); }
    [[nodiscard]] std::optional<Progress> progress() const override {
        if (!prepared_) return std::nullopt;
        return Progress{sender_.sent(), sender_.total(), "copying"};
    }
    [[nodiscard]] std::uint64_t held_bytes() const override { return leased_; }
    Frames farewell() override {
        Frames frames;
        frames.push_back(protocol::answer(caller_.request_id, wire::DoneT{}));
        return frames;
    }

private:
    Reply<void> make() {
        auto copy = services_.state->copy();
        if (!copy) return refuse(copy.error());
        copy_ = std::move(*copy);
        const std::uint64_t needed = memory_per_manifest_byte * copy_->manifest_bytes;
        auto lease = services_.budget.reserve(needed, caller_.principal);
        if (!lease)
            return services_.budget.refuse("the list of what is backed up", needed,
                                           caller_.principal,
                                           "start raynestd with a larger --memory");
        lease_ = std::move(*lease);
        leased_ = lease_.bytes();
        source_.add("manifest.sqlite", copy_->manifest, copy_->manifest_bytes);
        std::map<std::string, bool> is_whole;  // by digest
        for (const StoredScene& row : copy_->rows) {
            const auto blob = services_.state->path() / "blobs" / row.digest;
            const auto [known, is_new] = is_whole.try_emplace(row.digest, false);
            struct stat found {};
            if (is_new)
                known->second = ::lstat(blob.c_str(), &found) == 0 && S_ISREG(found.st_mode) &&
                                static_cast<std::uint64_t>(found.st_size) == row.bytes;
            // One that is damaged keeps no other from its backup.
            if (is_new && known->second)
                source_.add("blobs/" + row.digest, blob, row.bytes);
            else if (!known->second && notes_.size() < services_.limits.list_items_max)
                notes_.push_back("the scene " + row.owner + "/" + row.name +
                                 " is damaged: the backup has its name alone");
        }
        Payload payload;
        payload.width = payload.height = 1;
        sender_.set(std::move(payload), source_.bytes(),
                    [this](std::uint64_t offset, std::span<std::byte> into) -> Reply<void> {
                        if (const auto read = source_.read(offset, into); !read)
                            return refuse(read.error());
                        return {};
                    });
        return {};
    }

    const Services& services_;
    const Caller caller_;
    PayloadSender sender_;
    bool prepared_ = false;
    // Made by prepare()'s task.
    std::unique_ptr<StateCopy> copy_;
    ArchiveSource source_;
    std::vector<std::string> notes_;
    Budget::Lease lease_;
    std::atomic<std::uint64_t> leased_ = 0;  ///< its bytes, also while a task takes it
};

}  // namespace

Reply<Answer> backup(const Services& services, const Caller& caller,
                     const protocol::Opened<wire::Backup>& message) {
    if (services.state == nullptr)
        return refuse(Code::unsupported,
                      "there is nothing to back up: this daemon stores no scenes; start raynestd "
                      "with --state DIR");
    log_limited(LogLevel::info, "backup", caller.principal, {{"principal", caller.principal}});
    JobSubmission accepted;
    accepted.kind = "backup";
    accepted.deadline_ms = message->deadline_ms();
    accepted.job = std::make_unique<BackupJob>(services, caller);
    // The answer's size is known once the manifest is copied; a window of it is in memory at most.
    accepted.answer_bytes = caller.window_bytes;
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
