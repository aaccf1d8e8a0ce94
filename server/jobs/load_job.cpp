#include "server/jobs/load_job.h"

#include "engine/assets/sandbox/import_child.h"
#include "protocol/answer.h"
#include "protocol/hash.h"
#include "protocol/text.h"
#include "server/documents/scene_info.h"
#include "server/ground/limited_log.h"
#include "server/ground/metrics.h"
#include "server/jobs/change_gate.h"
#include "server/jobs/received_file.h"
#include "server/jobs/services.h"
#include "server/scheduling/admission.h"
#include "server/scheduling/peers.h"
#include "server/store/held_parts.h"
#include "server/store/import_memory.h"
#include "server/store/scene_files.h"
#include "server/store/state_folder.h"

#include <algorithm>
#include <numeric>
#include <utility>

namespace raynest::server {
namespace {

/// Address space of an import child: `base` for libraries, and `growth` times its largest scene.
constexpr std::uint64_t import_base_bytes = 1ULL << 30;
constexpr std::uint64_t import_growth = 4;
/// Epochs that a load leaves to edits, once these were faster than its commit.
constexpr std::uint64_t epochs_free = 1000;
/// Bytes of an upload for which stored scenes leave the memory together.
constexpr std::uint64_t room_at_once = 8 << 20;

bool is_intact(const UploadFile& file) {
    if (!file.digest) return protocol::upload_checksum(file.bytes.span()) == file.hash;
    protocol::Sha256 sum;
    sum.add(file.bytes.span());
    return sum.digest() == file.digest;
}

class LoadJob final : public Job {
public:
    LoadJob(const Services& services, const Caller& caller, LoadOrder order)
        : services_(services),
          id_(caller.request_id),
          order_(std::move(order)) {
        skip_complete_files();
    }

    /// Looks for files in the scenes that are there, which the client then need not send.
    std::optional<Task> prepare() override {
        // A client that gives no digests sends its files in any case.
        if (order_.known || std::ranges::none_of(order_.files, [](const UploadFile& file) {
                return file.digest.has_value();
            }))
            return std::nullopt;
        searched_ = services_.scenes.visible_scenes(order_.caller);
        if (searched_.empty()) return std::nullopt;
        is_searching_ = true;
        Task task;
        task.pool = &services_.blocking;
        task.run = [this](const Stop& stop) -> Reply<Frames> {
            std::vector<WantedFile> wanted;
            for (UploadFile& file : order_.files)
                wanted.push_back({file.digest ? &*file.digest : nullptr,
                                  {file.bytes.data(), file.bytes.size()}});
            const auto reserve = [&](std::uint64_t bytes) {
                auto lease = services_.budget.reserve(bytes, order_.caller.principal, Use::lasting);
                if (lease) found_lease_.merge(std::move(*lease));
                return lease.has_value();
            };
            found_ = fill_in_held_parts(searched_, wanted, reserve, stop);
            return Frames{};
        };
        return task;
    }
    Frames greeting() override {
        is_searching_ = false;
        searched_.clear();
        order_.lease.merge(std::move(found_lease_));
        for (std::size_t i = 0; i < found_.size(); ++i) {
            if (!found_[i]) continue;
            order_.files[i].received = order_.files[i].bytes.size();
            received_ += order_.files[i].received;
        }
        skip_complete_files();
        Frames frames;
        if (order_.known) return frames;
        wire::NeedT need;
        for (std::uint32_t i = 0; i < order_.files.size(); ++i)
            if (i >= found_.size() || !found_[i]) need.files.push_back(i);
        if (!need.files.empty()) frames.push_back(protocol::answer(id_, need));
        return frames;
    }

    Reply<std::uint64_t> feed(protocol::Frame frame) override {
        if (is_searching_)
            return refuse(Code::invalid_field, "send files once Need has come, which names them");
        const auto message = protocol::open<wire::Upload>(frame, services_.limits);
        if (!message) return tl::unexpected(message.error());
        const auto block = protocol::only_block(message->blocks, "data", wire::Dtype::u8, {1});
        if (!block) return tl::unexpected(block.error());
        if (import_started_ || current_ == order_.files.size())
            return refuse(Code::invalid_field, "all files of the upload are complete");
        UploadFile& file = order_.files[current_];
        if ((*message)->file() != current_ || (*message)->offset() != file.received)
            return refuse(Code::invalid_field, "expected byte " + std::to_string(file.received) +
                                                   " of file " + std::to_string(current_) +
                                                   " next");
        if (block->count > file.bytes.size() - file.received)
            return refuse(Code::invalid_field, "file " + std::to_string(current_) +
                                                   " is longer than its announced " +
                                                   std::to_string(file.bytes.size()) + " bytes");
        // Reserve each piece as it comes: an upload that is announced but not sent takes nothing.
        const std::string& principal = order_.caller.principal;
        if (block->count > services_.budget.room(principal, Use::lasting)) {
            // Also for the next pieces, as each call looks at all scenes.
            services_.scenes.make_room(
                std::max(block->count, std::min(announced_ - received_, room_at_once)), principal);
            services_.scenes.make_room(block->count, principal);
        }
        auto lease = services_.peers.reserve(block->count, principal, Use::lasting);
        if (!lease)
            return services_.budget.refuse("the rest of the upload", announced_ - received_,
                                           principal, memory_remedy());
        std::byte* const place = file.bytes.data() + file.received;
        file.received += block->count;
        order_.lease.merge(std::move(*lease));
        received_ += block->count;
        skip_complete_files();
        return copies_.add(block->bytes.first(block->count), place, std::move(frame));
    }

    ~LoadJob() override {
        // The row of a load that was stopped between its commit and its publication.
        if (committed_ && !scene_) services_.state->undo(stored_.row, std::move(stored_.before));
    }

    std::optional<Task> next() override {
        const std::string& principal = order_.caller.principal;
        if (commit_next_) return commit();
        // Close paused connections while the import grows: only it knows what it needs.
        if (memory_ && memory_->missing() != 0) make_room(memory_->missing());
        if (import_started_) return std::nullopt;
        if (order_.known) {
            import_started_ = true;
            snapshot_ = order_.known->snapshot;
            decide_whether_to_store();
            Task publish;
            publish.run = [this](const Stop& stop) -> Reply<Frames> {
                if (!is_stored_) return Frames{};
                return store(stop);
            };
            if (is_stored_)
                publish.pool = &services_.blocking;
            else
                publish.inline_cost = 1;
            return publish;
        }
        if (current_ < order_.files.size() || !copies_.all_copied()) return copies_.next();
        import_started_ = true;
        // Free memory for a copy of the files and a scene of about their size.
        services_.scenes.drop_spares();
        // An import tells what it needs only while it runs, and then cannot wait for stored scenes
        // to go.
        constexpr std::uint64_t part_kept_free = 4;
        if (!retried_) {
            make_room(2 * announced_);
            if (services_.state != nullptr) make_room(services_.budget.limit() / part_kept_free);
        }
        memory_.emplace(services_.budget, principal, Use::lasting,
                        services_.peers.reclaimable_bytes(principal));
        decide_whether_to_store();
        Task task;
        task.pool = &services_.blocking;
        task.run = [this, remedy = memory_remedy()](const Stop& stop) -> Reply<Frames> {
            auto snapshot = import(stop, remedy);
            if (!snapshot && snapshot.error().code == Code::resource_exhausted &&
                services_.state != nullptr && !retried_) {
                refused_ = snapshot.error();
                return Frames{};
            }
            if (!snapshot) return tl::unexpected(snapshot.error());
            snapshot_ = std::move(*snapshot);
            huge_bytes_ = snapshot_->huge_bytes();
            order_.files.clear();
            return is_stored_ ? store(stop) : Frames{};
        };
        return task;
    }

    Reply<void> ended() override {
        if (!import_started_) {
            copies_.ended();
            return {};
        }
        if (refused_) return retry();
        if (!committed_) {
            order_.lease = {};
            memory_.reset();
            // Another's copy saves memory, and is not told.
            reused_ = services_.scenes.shows(snapshot_->digest(), order_.caller);
            if (!services_.scenes.holds(snapshot_->arena_id()))
                make_room(snapshot_->bytes().size());
            else
                services_.scenes.make_room_in_quota(snapshot_->bytes().size(),
                                                    order_.caller.principal);
        }
        if (is_stored_ && !committed_) return prepare_to_commit(0);
        if (committed_) {
            if (services_.scenes.is_outdated(stored_.row, order_.caller))
                return prepare_to_commit(epochs_free);
            order_.publication.blob = blob_;
            order_.publication.row = stored_.row;
        }
        auto scene = services_.scenes.publish(order_.name, std::move(snapshot_), order_.publication,
                                              order_.caller);
        if (!scene) return tl::unexpected(scene.error());
        scene_ = std::move(*scene);
        stored_.claim.reset();
        if (committed_ && stored_.before) services_.state->forget(stored_.before->number);
        name_lock_.reset();
        services_.metrics.count<&Metrics::scenes_loaded>(order_.caller.principal);
        services_.metrics.load_seconds.add(seconds());
        log_limited(LogLevel::info, "loaded", order_.caller.principal,
                    {{"scene", scene_->name},
                     {"epoch", std::to_string(scene_->epoch)},
                     {"hash", scene_->snapshot().digest()},
                     {"bytes", std::to_string(scene_->snapshot().statistics().bytes)},
                     {"huge_page_bytes", std::to_string(huge_bytes_)},
                     {"seconds", std::to_string(seconds())},
                     {"principal", order_.caller.principal}});
        return {};
    }

    [[nodiscard]] bool finished() const override {
        return import_started_ && (!is_stored_ || commit_started_);
    }
    [[nodiscard]] bool needs_input() const override {
        return !is_searching_ && !import_started_ && !order_.known &&
               current_ < order_.files.size();
    }
    std::uint64_t take_freed_input() override { return copies_.take_freed(); }
    [[nodiscard]] std::uint64_t held_bytes() const override { return order_.lease.bytes(); }

    Frames farewell() override {
        wire::LoadedT loaded;
        loaded.info = std::make_unique<wire::SceneInfoT>(
            scene_info(*scene_, services_.registry, services_.limits));
        loaded.seconds = seconds();
        loaded.reused = reused_;
        Frames frames;
        frames.push_back(protocol::answer(id_, loaded));
        return frames;
    }

    [[nodiscard]] std::optional<Progress> progress() const override {
        if (import_started_) return Progress{0, 0, "importing"};
        return Progress{received_, announced_, "uploading"};
    }

private:
    [[nodiscard]] std::string memory_remedy() const {
        const std::string& principal = order_.caller.principal;
        // This one is among them.
        const auto loads = std::ranges::count_if(services_.admission.jobs(), [&](const auto& job) {
            return job.second.principal == principal && job.second.kind == "load";
        });
        return (loads > 1 ? "wait until your other loads have ended, or " : "") +
               services_.scenes.remedy(principal, "start raynestd with a larger --memory");
    }

    /// Closes paused connections, and lets go of stored scenes, until there is room for a scene of
    /// `bytes`.
    void make_room(std::uint64_t bytes) {
        services_.peers.make_memory(bytes, order_.caller.principal, Use::lasting);
        services_.scenes.make_room(bytes, order_.caller.principal,
                                   services_.peers.reclaimable_bytes(order_.caller.principal));
        // Requests of others may now be charged for what they read of it.
        services_.peers.make_memory(bytes, order_.caller.principal, Use::lasting);
    }

    /// The import found too little memory. Has it begin once more if stored scenes that nobody uses
    /// can leave theirs.
    Reply<void> retry() {
        const auto refused = *std::exchange(refused_, std::nullopt);
        const std::string& principal = order_.caller.principal;
        const std::uint64_t before = services_.budget.room(principal, Use::lasting);
        // The import still counts as its owner's: those who hold less keep their scenes.
        services_.scenes.make_all_room(principal);
        if (services_.budget.room(principal, Use::lasting) <= before)
            return tl::unexpected(refused);
        memory_.reset();
        retried_ = true;
        import_started_ = false;
        return {};
    }

    /// A scene is stored if it outlives the daemon.
    void decide_whether_to_store() {
        is_stored_ =
            services_.state != nullptr && (!order_.publication.temporary ||
                                           services_.scenes.is_stored(order_.name, order_.caller));
        if (is_stored_) disk_room_ = services_.scenes.disk_room(order_.name, order_.caller);
    }

    /// Writes the scene to the state folder, then waits until no other load of its name is under
    /// way. On a thread of the blocking pool.
    Reply<Frames> store(const Stop& stop) {
        const auto stopped = [&] { return stop.requested(); };
        if (auto fits = disk_room_.check(snapshot_->arena_id(), snapshot_->bytes().size()); !fits)
            return tl::unexpected(fits.error());
        auto blob = services_.state->keep(snapshot_->arena_id(), snapshot_->bytes(), stopped);
        if (stop.requested()) return refuse(Code::cancelled, "");
        if (!blob) return not_changed(*services_.state, std::move(blob.error()));
        blob_ = std::move(*blob);
        name_lock_ = services_.state->lock_name(order_.caller.principal, order_.name, stopped);
        if (!name_lock_) return refuse(Code::cancelled, "");
        return Frames{};
    }

    /// Makes the row that is to be committed next, in the place of one that has been. Io thread.
    Reply<void> prepare_to_commit(std::uint64_t epochs) {
        stored_.claim.reset();
        const std::uint64_t number = stored_.row.number;
        auto stored = services_.scenes.prepare_to_store(order_.name, snapshot_, order_.publication,
                                                        order_.caller, epochs);
        if (!stored) return tl::unexpected(stored.error());
        stored_ = std::move(*stored);
        stored_.row.number = number;
        commit_next_ = true;
        commit_started_ = false;
        return {};
    }

    /// Commits the row of the scene, before anybody sees it.
    Task commit() {
        commit_next_ = false;
        commit_started_ = true;
        Task task;
        // Not the pool of imports, where others may wait for this load.
        task.pool = services_.disk;
        task.run = [this](const Stop&) -> Reply<Frames> {
            // The scene before comes back if this load is stopped now.
            if (stored_.before) blob_before_ = services_.state->pin(stored_.before->digest);
            StoredScene row = stored_.row;
            row.number = services_.state->next_number();
            if (auto put = services_.state->put(row); !put)
                return not_changed(*services_.state, std::move(put.error()));
            stored_.row = std::move(row);
            committed_ = true;
            return Frames{};
        };
        return task;
    }

    [[nodiscard]] double seconds() const {
        return std::chrono::duration<double>(Clock::now() - started_).count();
    }

    /// Skips files that need no more pieces: empty ones, and the one that was just completed.
    void skip_complete_files() {
        if (order_.known) return;
        while (current_ < order_.files.size() &&
               order_.files[current_].received == order_.files[current_].bytes.size())
            ++current_;
    }

    /// Imports the scene on a thread of the blocking pool. The io thread does not use order_ then.
    Reply<std::shared_ptr<const Snapshot>> import(const Stop& stop, const std::string& remedy) {
        const std::string& principal = order_.caller.principal;
        const auto with_remedy = [&](Error error) {
            if (error.code == ErrorCode::out_of_memory) error.message += "; " + remedy;
            return refuse(std::move(error));
        };
        ImportRequest request;
        request.source = order_.source;
        request.primitive = order_.primitive;
        request.build = order_.build;
        request.origin = order_.origin;
        request.options = order_.options;
        request.masks = order_.masks;
        request.variant = order_.variant;
        for (const UploadFile& file : order_.files) {
            if (!is_intact(file))
                return refuse(Code::scene_invalid,
                              "'" + file.name + "' was damaged on its way: its hash differs");
            request.files.push_back({file.name, file.bytes.span()});
        }
        std::vector<SourceFile> found;
        if (order_.disk) {
            auto files =
                read_scene(order_.disk->root, order_.disk->path, services_.limits.upload_files_max,
                           services_.import_limits.file_bytes_max, {services_.budget, principal});
            if (!files) return with_remedy(files.error());
            found = std::move(*files);
            request.source = found.front().name;
            for (const SourceFile& file : found) request.files.push_back({file.name, file.bytes});
        }
        // Reserve memory for the child's copy of the files.
        std::uint64_t copied = 0;
        for (const NamedBytes& file : request.files) copied += file.bytes.size();
        const auto copy = services_.budget.reserve(copied, principal, Use::lasting);
        if (!copy)
            return services_.budget.refuse("the import's copy of the files", copied, principal,
                                           remedy);
        ImportLimits limits = services_.import_limits;
        // Let the child refuse a scene that does not fit, before this process maps it. While it
        // works, a child may hold a few times the bytes of the scene, besides its libraries.
        limits.scene_bytes_max = memory_->room();
        limits.bytes_max =
            std::min(limits.bytes_max, import_base_bytes + import_growth * limits.scene_bytes_max);
        // Stop the child with the task; the runner stops that at the job's deadline.
        auto snapshot = import_in_child(
            request, limits, services_.import_child,
            [&](std::uint64_t bytes) { return !stop.requested() && memory_->cover(bytes); });
        if (stop.requested()) return refuse(Code::cancelled, "");
        if (memory_->refused()) return memory_->refusal("the import", remedy);
        if (!snapshot) return with_remedy(snapshot.error());
        memory_->shrink((*snapshot)->bytes().size());
        return std::move(*snapshot);
    }

    const Services& services_;
    const std::uint64_t id_;
    const Clock::time_point started_ = Clock::now();
    LoadOrder order_;
    const std::uint64_t announced_ = std::accumulate(
        order_.files.begin(), order_.files.end(), std::uint64_t{0},
        [](std::uint64_t sum, const UploadFile& file) { return sum + file.bytes.size(); });
    std::uint64_t received_ = 0;
    std::size_t current_ = 0;  ///< index of the file that is being received
    bool is_searching_ = false;
    std::vector<std::shared_ptr<const HeldScene>> searched_;
    std::vector<bool> found_;    ///< files that scenes had; written by the task that searches
    Budget::Lease found_lease_;  ///< for them; likewise
    UploadCopies copies_;
    bool import_started_ = false;
    std::optional<protocol::Error> refused_;  ///< an import without memory; written by the task
    bool retried_ = false;
    std::optional<ImportMemory> memory_;  ///< the import child's, then its scene's
    bool reused_ = false;
    std::shared_ptr<const Snapshot> snapshot_;  ///< written by the import task
    std::size_t huge_bytes_ = 0;                ///< likewise
    std::optional<NamedScene> scene_;
    // For scenes that outlive the daemon:
    bool is_stored_ = false;
    DiskRoom disk_room_;  ///< if it is
    bool commit_next_ = false;
    bool commit_started_ = false;
    bool committed_ = false;           ///< written by the task
    BlobPin blob_;                     ///< likewise
    BlobPin blob_before_;              ///< likewise
    std::shared_ptr<void> name_lock_;  ///< likewise
    SceneStore::Stored stored_;
};

}  // namespace

std::unique_ptr<Job> load_job(const Services& services, const Caller& caller, LoadOrder order) {
    return std::make_unique<LoadJob>(services, caller, std::move(order));
}

}  // namespace raynest::server
