// RESTORE: brings scenes of a backup back while the daemon goes on: those whose names are free, and
// those that are damaged here. All others stay as they are.
//
//   Uploads ──► files of the state folder ──► rows ──► (names locked ──► committed ──► entered)...
#include "protocol/answer.h"
#include "protocol/blocks.h"
#include "protocol/text.h"
#include "server/documents/json.h"
#include "server/ground/limited_log.h"
#include "server/jobs/change_gate.h"
#include "server/jobs/payload_sender.h"
#include "server/jobs/services.h"
#include "server/requests/request.h"
#include "server/scheduling/fair_thread_pool.h"
#include "server/store/archive.h"
#include "server/store/scene_store.h"

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Scenes that come back in one commit: the io thread looks at so many at a time.
constexpr std::size_t batch_scenes = 128;
/// Bytes of the manifest in memory, for each of its own: its rows, and the edits of one scene.
constexpr std::uint64_t manifest_copies = 8;

/// An epoch that a manifest can have; what is told of it may grow for ever.
constexpr std::uint64_t epoch_most = 1ULL << 60;
/// Bytes of a scene, far beyond what a machine has.
constexpr std::uint64_t bytes_most = 1ULL << 48;

std::string full_name(const StoredScene& row) {
    return row.owner + "/" + row.name;
}

/// True for a row that a load can have made. Others break the lists of scenes.
bool can_be_loaded(const StoredScene& row, const protocol::Limits& limits) {
    const auto is_name = [&](std::string_view text) {
        return !text.empty() && text.size() <= limits.name_bytes_max;
    };
    return is_name(row.name) && is_name(row.owner) && row.name.find('/') == std::string::npos &&
           row.share.names().size() <= limits.list_items_max &&
           std::ranges::all_of(row.share.names(), is_name);
}

class RestoreJob final : public Job {
public:
    RestoreJob(const Services& services, const Caller& caller, std::uint64_t bytes,
               std::vector<std::string> wanted)
        : services_(services),
          caller_(caller),
          bytes_(bytes),
          wanted_(std::move(wanted)),
          target_(*services.state),
          sender_(services.limits, caller, "json") {}

    ~RestoreJob() override {
        // Rows of a job that was stopped between their commit and their entry.
        for (const ReturningScene& scene : committed_) undo(scene);
    }

    Reply<std::uint64_t> feed(protocol::Frame frame) override {
        const auto message = protocol::open<wire::Upload>(frame, services_.limits);
        if (!message) return tl::unexpected(message.error());
        const auto block = protocol::only_block(message->blocks, "data", wire::Dtype::u8, {1});
        if (!block) return tl::unexpected(block.error());
        if ((*message)->file() != 0 || (*message)->offset() != received_)
            return refuse(Code::invalid_field,
                          "expected byte " + std::to_string(received_) + " of file 0 next");
        if (block->count > bytes_ - received_)
            return refuse(Code::invalid_field, "the file is longer than its announced " +
                                                   std::to_string(bytes_) + " bytes");
        received_ += block->count;
        waiting_.push_back({block->bytes.first(block->count), std::move(frame)});
        return 0;
    }
    [[nodiscard]] bool needs_input() const override { return received_ < bytes_; }
    std::uint64_t take_freed_input() override { return freed_.exchange(0); }

    std::optional<Task> next() override {
        if (step_ == Step::tell) return sender_.next();
        if (is_running_) return std::nullopt;
        if (step_ == Step::receive) {
            if (waiting_.empty()) return std::nullopt;
            writing_.swap(waiting_);
            return disk_task([this](const Stop& stop) { return write(stop); });
        }
        if (step_ == Step::open) return disk_task([this](const Stop& stop) { return open(stop); });
        if (step_ == Step::commit) return disk_task([this](const Stop&) { return commit(); });
        if (step_ == Step::describe) return disk_task([this](const Stop&) { return describe(); });
        Task task = disk_task([this](const Stop& stop) { return lock(stop); });
        task.pool = &services_.blocking;
        return task;
    }

    Reply<void> ended() override {
        if (step_ == Step::tell) {
            sender_.ended();
            return {};
        }
        is_running_ = false;
        if (step_ == Step::receive && received_ == bytes_ && waiting_.empty()) {
            step_ = Step::open;
        } else if (step_ == Step::open) {
            step_ = Step::lock;
        } else if (step_ == Step::lock) {
            choose();
            step_ = Step::commit;
        } else if (step_ == Step::commit) {
            enter();
            step_ = Step::lock;
        } else if (step_ == Step::describe) {
            step_ = Step::tell;
        }
        if (step_ == Step::lock && next_row_ == rows_.size()) step_ = Step::describe;
        return {};
    }
    [[nodiscard]] bool finished() const override {
        return step_ == Step::tell && sender_.finished();
    }
    [[nodiscard]] std::uint64_t held_bytes() const override { return leased_; }
    [[nodiscard]] std::optional<Progress> progress() const override {
        if (step_ == Step::receive) return Progress{received_, bytes_, "uploading"};
        return Progress{0, 0, "restoring"};
    }
    Frames farewell() override {
        Frames frames;
        frames.push_back(protocol::answer(caller_.request_id, wire::DoneT{}));
        return frames;
    }

private:
    enum class Step { receive, open, lock, commit, describe, tell };

    template <class Work>
    Task disk_task(Work work) {
        is_running_ = true;
        Task task;
        task.pool = services_.disk;
        task.run = [work = std::move(work)](const Stop& stop) -> Reply<Frames> {
            if (auto done = work(stop); !done) return tl::unexpected(done.error());
            return Frames{};
        };
        return task;
    }

    /// Takes the row of a scene away again that nobody has seen yet.
    void undo(const ReturningScene& scene) const {
        services_.state->undo(
            scene.new_row(), scene.before ? std::make_unique<StoredScene>(*scene.before) : nullptr);
    }

    /// Writes what has come. On a thread for the disk.
    Reply<void> write(const Stop& stop) {
        for (Received& piece : writing_) {
            if (auto taken = target_.take(piece.data); !taken) return not_restored(taken.error());
            freed_ += piece.frame.header.bulk_bytes;
            piece.frame.bulk = {};
            // It comes first as a rule; then only what is wanted takes room.
            if (!manifest_ && target_.has_manifest()) {
                if (auto read = read_rows(stop); !read) return read;
                std::set<std::string> digests;
                for (const ReturningScene& scene : rows_) digests.insert(scene.row.digest);
                target_.want(std::move(digests));
            }
        }
        writing_.clear();
        return {};
    }

    /// Sees to it that all has come. Likewise.
    Reply<void> open(const Stop& stop) {
        if (auto finished = target_.finish(); !finished) return not_restored(finished.error());
        return manifest_ ? Reply<void>() : read_rows(stop);
    }

    /// Reads the rows of the scenes that are wanted. Likewise.
    Reply<void> read_rows(const Stop& stop) {
        std::error_code error;
        const std::uint64_t needed =
            manifest_copies * std::filesystem::file_size(target_.manifest(), error);
        auto lease = services_.budget.reserve(needed, caller_.principal);
        if (!lease)
            return services_.budget.refuse("the backup's manifest", needed, caller_.principal,
                                           "start raynestd with a larger --memory");
        lease_ = std::move(*lease);
        leased_ = lease_.bytes();
        // Its errors name a file that nobody knows.
        const auto damaged = refuse(Code::scene_invalid,
                                    "the manifest of the backup is damaged, or a newer release of "
                                    "raynestd wrote it; nothing was changed");
        auto manifest = Manifest::open(target_.manifest(), true);
        if (!manifest) return damaged;
        manifest_.emplace(std::move(*manifest));
        auto stored = manifest_->rows();
        if (!stored) return damaged;
        std::set<std::string> unknown(wanted_.begin(), wanted_.end());
        for (StoredScene& row : *stored) {
            if (stop.requested()) return refuse(Code::cancelled, "");
            unknown.erase(full_name(row));
            if (!wanted_.empty() && std::ranges::find(wanted_, full_name(row)) == wanted_.end())
                continue;
            auto edits = manifest_->sum_of_edits(row.number);
            if (!edits || row.epoch > epoch_most || edits->epoch_last > epoch_most) return damaged;
            ReturningScene& scene = rows_.emplace_back();
            const auto changes = manifest_->edits(row.number);
            scene.is_damaged = !can_be_loaded(row, services_.limits) || !changes ||
                               !gap_in(*changes, row.epoch).empty() ||
                               edits->last.bytes > bytes_most;
            scene.row = std::move(row);
            scene.edits = std::move(*edits);
        }
        if (!unknown.empty())
            return refuse(Code::not_found, "the backup has no scene '" + *unknown.begin() +
                                               "'; name scenes as OWNER/NAME");
        // Always in one order, so that two who lock names do not wait for each other.
        std::ranges::sort(rows_, {}, [](const ReturningScene& scene) {
            return std::pair(scene.row.owner, scene.row.name);
        });
        const auto twice = std::ranges::adjacent_find(rows_, [](const auto& a, const auto& b) {
            return a.row.owner == b.row.owner && a.row.name == b.row.name;
        });
        if (twice != rows_.end())
            return refuse(Code::scene_invalid,
                          "the backup has the scene '" + full_name(twice->row) + "' twice");
        return {};
    }

    /// Keeps loads from the next names; waits for those under way. On a blocking thread.
    Reply<void> lock(const Stop& stop) {
        batch_end_ = std::min(next_row_ + batch_scenes, rows_.size());
        for (std::size_t i = next_row_; i < batch_end_; ++i) {
            const StoredScene& row = rows_[i].row;
            locks_.push_back(services_.state->lock_name(row.owner, row.name,
                                                        [&stop] { return stop.requested(); }));
            if (!locks_.back()) return refuse(Code::cancelled, "");
        }
        return {};
    }

    /// Chooses those of the next that come back.
    void choose() {
        for (; next_row_ < batch_end_; ++next_row_) {
            using State = SceneStore::Place::State;
            ReturningScene& scene = rows_[next_row_];
            const StoredScene& row = scene.row;
            const auto place = services_.scenes.place_for(row);
            if (place.state == State::taken) {
                taken_.push_back(full_name(row));
            } else if (const auto blob = target_.blobs().find(row.digest);
                       blob == target_.blobs().end() || blob->second.bytes != row.bytes ||
                       scene.is_damaged) {
                missing_.push_back(full_name(row));
            } else if (place.state == State::damaged && place.row.digest == row.digest &&
                       !place.edits_damaged) {
                // Its kept edits stay, also those made since the backup. A load may have written its
                // blob anew meanwhile.
                mended_.push_back({full_name(row), row.digest});
            } else {
                if (place.state == State::damaged) scene.before = place.row;
                scene.later = std::max(place.epoch, row.epoch) - row.epoch;
                returning_.push_back(std::move(scene));
            }
        }
    }

    /// Has their blobs and rows on the disk. On a thread for the disk.
    Reply<void> commit() {
        std::map<std::string, std::filesystem::path> files;
        const auto need = [&](const std::string& digest) {
            if (!pins_.contains(digest)) files[digest] = target_.blobs().at(digest).file;
        };
        for (std::size_t i = mended_entered_; i < mended_.size(); ++i) need(mended_[i].digest);
        for (const ReturningScene& scene : returning_) need(scene.row.digest);
        auto pins = services_.state->take_blobs(files);
        if (!pins) return not_restored(pins.error());
        pins_.merge(*pins);
        for (ReturningScene& scene : returning_) {
            scene.number = services_.state->next_number();
            scene.blob = pins_.at(scene.row.digest);
        }
        if (const auto put = services_.state->put(returning_, *manifest_); !put)
            return not_restored(put.error());
        committed_ = std::exchange(returning_, {});
        return {};
    }

    /// Has everybody see them.
    void enter() {
        for (const ReturningScene& scene : std::exchange(committed_, {})) {
            // A temporary scene, which waits for nobody's lock, has taken the name meanwhile.
            if (services_.scenes.place_for(scene.row).state == SceneStore::Place::State::taken) {
                undo(scene);
                taken_.push_back(full_name(scene.row));
                continue;
            }
            services_.scenes.adopt(scene);
            if (scene.before) services_.state->forget(scene.before->number);
            restored_.push_back(full_name(scene.row));
        }
        std::set<std::string> whole;
        for (; mended_entered_ < mended_.size(); ++mended_entered_)
            whole.insert(mended_[mended_entered_].digest);
        if (!whole.empty()) services_.scenes.mend(whole);
        locks_.clear();
    }

    /// Makes the answer. Likewise.
    Reply<void> describe() {
        Json mended = Json::array();
        for (const Mended& scene : mended_) mended.push_back(scene.name);
        log_limited(LogLevel::info, "restored", caller_.principal,
                    {{"principal", caller_.principal},
                     {"scenes", std::to_string(restored_.size() + mended_.size())}});
        sender_.set(json_payload(1, 1,
                                 text_of(Json{{"restored", restored_},
                                              {"mended", std::move(mended)},
                                              {"kept", taken_},
                                              {"missing", missing_}})));
        return {};
    }

    [[nodiscard]] tl::unexpected<protocol::Error> not_restored(Error why) const {
        if (!restored_.empty())
            why.message += "; " + std::to_string(restored_.size()) + " scenes are back already";
        return not_changed(*services_.state, std::move(why));
    }

    const Services& services_;
    const Caller caller_;
    const std::uint64_t bytes_;
    const std::vector<std::string> wanted_;  ///< empty: all
    Step step_ = Step::receive;
    bool is_running_ = false;
    std::uint64_t received_ = 0;
    struct Received {
        std::span<const std::byte> data;
        protocol::Frame frame;
    };
    std::vector<Received> waiting_;
    std::vector<Received> writing_;  ///< for the task
    std::atomic<std::uint64_t> freed_{0};
    // Used by the tasks and, between them, by the io thread.
    ArchiveTarget target_;
    Budget::Lease lease_;
    std::atomic<std::uint64_t> leased_ = 0;  ///< its bytes, also while a task takes it
    std::optional<Manifest> manifest_;
    std::vector<ReturningScene> rows_;
    std::size_t next_row_ = 0;
    std::size_t batch_end_ = 0;
    std::vector<std::shared_ptr<void>> locks_;
    std::map<std::string, BlobPin> pins_;    ///< pins of blobs that were taken, until the end
    std::vector<ReturningScene> returning_;  ///< in this batch
    std::vector<ReturningScene> committed_;  ///< likewise, once their rows are on the disk
    struct Mended {
        std::string name;
        std::string digest;
    };
    std::vector<Mended> mended_;
    std::size_t mended_entered_ = 0;
    std::vector<std::string> restored_;
    std::vector<std::string> taken_;
    std::vector<std::string> missing_;
    PayloadSender sender_;
};

}  // namespace

Reply<Answer> restore_scenes(const Services& services, const Caller& caller,
                             const protocol::Opened<wire::Restore>& message) {
    if (services.state == nullptr)
        return refuse(Code::unsupported,
                      "scenes of a backup come back to a daemon that stores scenes alone: start "
                      "raynestd with --state DIR");
    if (message->bytes() == 0) return refuse(Code::invalid_field, "the backup is empty");
    std::vector<std::string> wanted = protocol::strings(message->scenes());
    std::error_code error;
    const auto space = std::filesystem::space(services.state->path(), error);
    if (!error && wanted.empty() && space.available < message->bytes())
        return refuse(Code::resource_exhausted,
                      "the backup has " + protocol::bytes_text(message->bytes()) +
                          ", more than is free on the disk of the state folder; make room there");
    JobSubmission accepted;
    accepted.kind = "restore";
    accepted.deadline_ms = message->deadline_ms();
    accepted.input_bytes = message->bytes();
    accepted.answer_bytes = caller.window_bytes;
    accepted.job =
        std::make_unique<RestoreJob>(services, caller, message->bytes(), std::move(wanted));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
