#include "server/jobs/edit_job.h"

#include "engine/scene/edits/batch.h"
#include "engine/scene/edits/edit.h"
#include "protocol/answer.h"
#include "protocol/control.h"
#include "protocol/text.h"
#include "server/ground/limited_log.h"
#include "server/ground/metrics.h"
#include "server/jobs/change_gate.h"
#include "server/jobs/edit_memory.h"
#include "server/jobs/received_file.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"
#include "server/store/state_folder.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

class EditJob final : public Job {
public:
    EditJob(const Services& services, const Caller& caller, EditOrder order)
        : services_(services),
          id_(caller.request_id),
          caller_(caller),
          order_(std::move(order)),
          rows_(0, order_.content.bytes()) {}

    Reply<std::uint64_t> feed(protocol::Frame frame) override {
        const auto message = protocol::open<wire::Upload>(frame, services_.limits);
        if (!message) return tl::unexpected(message.error());
        const auto block = protocol::only_block(message->blocks, "data", wire::Dtype::u8, {1});
        if (!block) return tl::unexpected(block.error());
        const auto place = rows_.place(*message->table, block->count);
        if (!place) return tl::unexpected(place.error());
        return copies_.add(block->bytes.first(block->count), *place, std::move(frame));
    }

    std::optional<Task> next() override {
        if (keeping_ == Keep::waits) return keep();
        if (task_started_) return std::nullopt;
        if (!rows_.complete() || !copies_.all_copied()) return copies_.next();
        task_started_ = true;
        Task task;
        task.pool = &services_.blocking;
        task.run = [this, ready = prepare_edit()](const Stop& stop) -> Reply<Frames> {
            if (!ready) return tl::unexpected(ready.error());
            auto edited = edit(stop);
            if (!edited) return tl::unexpected(edited.error());
            snapshot_ = std::move(*edited);
            if (const auto stored = store(stop); !stored) return tl::unexpected(stored.error());
            return Frames{};
        };
        return task;
    }

    Reply<void> ended() override {
        if (!task_started_) {
            copies_.ended();
            return {};
        }
        if (keeping_ == Keep::runs) return kept();
        lease_ = {};
        auto published = services_.scenes.publish_edit(*before_, std::exchange(snapshot_, nullptr),
                                                       caller_, publication_);
        if (!published) return tl::unexpected(published.error());
        if (!*published) {
            // Another edit was faster. With an epoch of its own this one now fails by that.
            task_started_ = false;
            name_lock_.reset();
            return {};
        }
        after_ = std::move(**published);
        if (publication_.keep) {
            services_.state->hand_in(publication_.keep);
            keeping_ = Keep::waits;
        }
        before_.reset();
        services_.metrics.count<&Metrics::scenes_edited>(caller_.principal);
        log_limited(LogLevel::debug, "edited", caller_.principal,
                    {{"scene", after_->name},
                     {"epoch", std::to_string(after_->epoch)},
                     {"principal", caller_.principal}});
        return {};
    }

    [[nodiscard]] bool finished() const override {
        return after_ && (keeping_ == Keep::not_asked || keeping_ == Keep::done);
    }
    [[nodiscard]] bool needs_input() const override { return !rows_.complete(); }
    std::uint64_t take_freed_input() override { return copies_.take_freed(); }
    [[nodiscard]] std::uint64_t held_bytes() const override {
        return order_.lease.bytes() + lease_.bytes();
    }

    Frames farewell() override {
        const EditStatistics& edits = after_->snapshot().statistics().edits;
        wire::EditedT edited;
        edited.epoch = after_->epoch;
        edited.hash = after_->snapshot().digest();
        edited.instances = instances_;
        edited.refits = edits.refits;
        edited.rebuilds = edits.rebuilds;
        edited.kept = after_->kept;
        edited.notes = notes_;
        edited.seconds = std::chrono::duration<double>(Clock::now() - started_).count();
        Frames frames;
        frames.push_back(protocol::answer(id_, edited));
        return frames;
    }

    [[nodiscard]] std::optional<Progress> progress() const override {
        if (keeping_ != Keep::not_asked) return Progress{0, 0, "storing"};
        if (task_started_) return Progress{0, 0, "editing"};
        return Progress{rows_.received(), rows_.bytes().size(), "uploading"};
    }

private:
    /// Takes the scene that is edited, and memory for its copy. It is the scene of this moment:
    /// edits may be on their way beside each other.
    Reply<void> prepare_edit() {
        auto scene = services_.scenes.find(order_.scene, order_.epoch, caller_);
        if (!scene) return tl::unexpected(scene.error());
        before_ = std::move(*scene);
        spare_ = services_.scenes.take_spare(*before_, caller_);
        auto plan = services_.scenes.plan_edit(*before_, rows_.bytes().size(), order_.keep,
                                               !order_.content.sources.empty(), caller_);
        if (!plan) return tl::unexpected(plan.error());
        publication_ = {.plan = std::move(*plan)};
        const std::uint64_t bytes = before_->snapshot().bytes().size();
        auto lease = services_.peers.reserve(bytes, caller_.principal, Use::lasting);
        if (!lease)
            return services_.budget.refuse(
                "the edited copy of the scene", bytes, caller_.principal,
                services_.scenes.remedy(caller_.principal,
                                        "start raynestd with a larger --memory"));
        lease_ = std::move(*lease);
        return {};
    }

    /// Makes the changed scene. On a thread of the blocking pool.
    Reply<std::shared_ptr<const Snapshot>> edit(const Stop& stop) {
        const Snapshot& scene = before_->snapshot();
        EditMemory memory(services_.budget, caller_.principal, Use::lasting);
        const EditGuard guard = memory.guard([&] { return stop.requested(); });
        const auto failed = [&](protocol::Error error) -> tl::unexpected<protocol::Error> {
            if (stop.requested()) return refuse(Code::cancelled, "");
            if (memory.refused() == 0) return tl::unexpected(std::move(error));
            return services_.budget.refuse(
                "the changed scene", memory.refused(), caller_.principal,
                "unload scenes, or start raynestd with a larger --memory");
        };
        EditBatch batch(scene, guard);
        if (auto read =
                read_edit(batch, scene, before_->name, order_.content, rows_.bytes(), guard);
            !read)
            return failed(std::move(read.error()));
        instances_ = static_cast<std::uint32_t>(batch.size());
        publication_.summary = edit_summary(scene, order_.content, rows_.bytes());
        auto edited = edit_scene(scene, batch.changes(), std::move(spare_), guard);
        if (!edited) return failed(refuse(std::move(edited.error())).value());
        note_lost_animations(**edited);
        return std::move(*edited);
    }

    /// Added parts stand still, and a scene with primitives of its own becomes a part of another.
    void note_lost_animations(const Snapshot& edited) {
        const auto moves = [](const Snapshot& scene) { return !scene.motion_bytes().empty(); };
        notes_.clear();  // from an attempt that another edit came before
        std::size_t lost = 0;
        const EditContent::Source* first = nullptr;
        for (const EditContent::Source& source : order_.content.sources) {
            if (!moves(*source.held->snapshot)) continue;
            if (lost++ == 0) first = &source;
        }
        if (first != nullptr) {
            constexpr std::size_t name_most = 100;
            notes_.push_back(fmt::format(
                "the animations of '{}'{} do not play here: what an edit adds is moved by edits",
                protocol::clean_text(first->name, name_most),
                lost == 1 ? "" : fmt::format(" and {} more", lost - 1)));
        }
        if (moves(before_->snapshot()) && !moves(edited))
            notes_.emplace_back(
                "the scene's own animations do not play any more: it has primitives beside its "
                "instances, and these became a part of what it is now");
    }

    /// Puts on the disk what must be there before anybody sees the edit. On a thread of the
    /// blocking pool.
    Reply<void> store(const Stop& stop) {
        const EditPlan& plan = publication_.plan;
        const auto stopped = [&] { return stop.requested(); };
        if (plan.reserve != 0)
            if (auto done = services_.state->reserve(plan.row.number, plan.reserve); !done)
                return not_changed(*services_.state, std::move(done.error()));
        if (!order_.keep) return {};
        publication_.keep = std::make_shared<Keeping>();
        if (!plan.whole) {
            auto change = kept_change(order_.content, rows_.bytes());
            if (!change) return tl::unexpected(change.error());
            publication_.keep->edit.change = std::move(*change);
            return {};
        }
        const auto digest = snapshot_->arena_digest();
        if (!digest) return refuse(digest.error());
        if (auto fits = plan.room.check(*digest, snapshot_->bytes().size()); !fits) return fits;
        // No load may put its scene in the place of this one between here and the commit.
        name_lock_ = services_.state->lock_name(plan.row.owner, plan.row.name, stopped);
        if (!name_lock_) return refuse(Code::cancelled, "");
        auto blob = services_.state->keep(*digest, snapshot_->bytes(), stopped);
        if (stop.requested()) return refuse(Code::cancelled, "");
        if (!blob) return not_changed(*services_.state, std::move(blob.error()));
        publication_.blob = std::move(*blob);
        publication_.number = services_.state->next_number();
        return {};
    }

    /// Commits the edit, which everybody sees already.
    Task keep() {
        keeping_ = Keep::runs;
        Task task;
        task.pool = services_.disk;
        task.run = [this](const Stop&) -> Reply<Frames> {
            outcome_ = services_.state->commit(publication_.keep);
            return Frames{};
        };
        return task;
    }

    Reply<void> kept() {
        keeping_ = Keep::done;
        name_lock_.reset();
        if (outcome_) return {};
        services_.scenes.edit_was_not_kept(publication_.keep->edit.number);
        return refuse(Code::resource_exhausted,
                      fmt::format("the edit was made, epoch {}, but is not kept: {}", after_->epoch,
                                  outcome_.error().message));
    }

    const Services& services_;
    const std::uint64_t id_;
    const Caller caller_;
    const Clock::time_point started_ = Clock::now();
    const EditOrder order_;
    ReceivedFile rows_;
    UploadCopies copies_;
    bool task_started_ = false;
    Budget::Lease lease_;                       ///< for the edited copy until it is published
    std::optional<NamedScene> before_;          ///< the epoch that is edited
    std::shared_ptr<const Snapshot> spare_;     ///< in whose memory the edited scene may be made
    std::shared_ptr<const Snapshot> snapshot_;  ///< written by the task
    std::uint32_t instances_ = 0;               ///< likewise
    std::vector<std::string> notes_;            ///< likewise
    std::optional<NamedScene> after_;
    EditPublication publication_;
    enum class Keep { not_asked, waits, runs, done } keeping_ = Keep::not_asked;
    std::shared_ptr<void> name_lock_;  ///< written by the task
    Result<void> outcome_;             ///< written by the task that commits
};

}  // namespace

std::unique_ptr<Job> edit_job(const Services& services, const Caller& caller, EditOrder order) {
    return std::make_unique<EditJob>(services, caller, std::move(order));
}

}  // namespace raynest::server
