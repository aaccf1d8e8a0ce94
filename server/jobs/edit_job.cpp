#include "server/jobs/edit_job.h"

#include "engine/scene/edits/batch.h"
#include "engine/scene/edits/edit.h"
#include "engine/scene/edits/names.h"
#include "protocol/control.h"
#include "protocol/text.h"
#include "server/ground/limited_log.h"
#include "server/ground/metrics.h"
#include "server/jobs/received_file.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <optional>
#include <utility>

namespace raynest::server {
namespace {

// Rows say a frame by its number.
static_assert(static_cast<std::uint32_t>(EditFrame::world) == EditRow::world &&
              static_cast<std::uint32_t>(EditFrame::parent) == EditRow::parent &&
              static_cast<std::uint32_t>(EditFrame::own) == EditRow::own);

/// Returns a row's matrix; nothing if a number is not finite.
std::optional<Matrix> matrix_of(const EditRow& row) {
    Matrix made(1);
    for (int i = 0; i < 12; ++i) {
        if (!std::isfinite(row.m[i])) return std::nullopt;
        made[i % 4][i / 4] = row.m[i];
    }
    return made;
}

class EditJob final : public Job {
public:
    EditJob(const Services& services, const Caller& caller, EditOrder order)
        : services_(services),
          id_(caller.request_id),
          caller_(caller),
          order_(std::move(order)),
          rows_(0, order_.bytes()) {}

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
            return Frames{};
        };
        return task;
    }

    Reply<void> ended() override {
        if (!task_started_) {
            copies_.ended();
            return {};
        }
        lease_ = {};
        auto published =
            services_.scenes.publish_edit(*before_, std::exchange(snapshot_, nullptr), caller_);
        if (!published) return tl::unexpected(published.error());
        if (!*published) {
            // Another edit was faster. With an epoch of its own this one now fails by that.
            task_started_ = false;
            return {};
        }
        after_ = std::move(**published);
        before_.reset();
        services_.metrics.count<&Metrics::scenes_edited>(caller_.principal);
        log_limited(LogLevel::debug, "edited", caller_.principal,
                    {{"scene", after_->name},
                     {"epoch", std::to_string(after_->epoch)},
                     {"principal", caller_.principal}});
        return {};
    }

    [[nodiscard]] bool finished() const override { return after_.has_value(); }
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
        edited.seconds = std::chrono::duration<double>(Clock::now() - started_).count();
        Frames frames;
        frames.push_back(*protocol::encode(id_, edited));
        return frames;
    }

    [[nodiscard]] std::optional<Progress> progress() const override {
        if (task_started_) return Progress{0, 0, "editing"};
        return Progress{rows_.received(), rows_.bytes().size(), "uploading"};
    }

private:
    /// Takes the scene that is edited, and memory for its copy. It is the scene of this moment: edits may
    /// be on their way beside each other.
    Reply<void> prepare_edit() {
        auto scene = services_.scenes.find(order_.scene, order_.epoch, caller_);
        if (!scene) return tl::unexpected(scene.error());
        before_ = std::move(*scene);
        spare_ = services_.scenes.take_spare(*before_, caller_);
        const std::uint64_t bytes = before_->snapshot().bytes().size();
        auto lease = services_.peers.reserve(bytes, caller_.principal, Use::lasting);
        if (!lease)
            return services_.budget.refuse(
                "the edited copy of the scene", bytes, caller_.principal,
                services_.scenes.remedy(caller_.principal, "start raynestd with a larger --memory"));
        lease_ = std::move(*lease);
        return {};
    }

    /// Makes the changed scene. On a thread of the blocking pool.
    Reply<std::shared_ptr<const Snapshot>> edit(const Stop& stop) {
        const Snapshot& scene = before_->snapshot();
        EditBatch batch(scene);
        if (auto read = read_rows(batch, stop); !read) return tl::unexpected(read.error());
        instances_ = static_cast<std::uint32_t>(batch.size());
        const SceneChanges changes = batch.changes();
        if (stop.requested()) return refuse(Code::cancelled, "");
        const auto more = reserve_for(changes);
        if (!more) return tl::unexpected(more.error());
        auto edited = edit_scene(scene, changes, std::move(spare_));
        if (!edited) return refuse(std::move(edited.error()));
        return std::move(*edited);
    }

    /// Reserves what an edit needs that does not only move outermost instances: the new scene besides the
    /// copy, with what comes to it.
    Reply<Budget::Lease> reserve_for(const SceneChanges& changes) const {
        const auto is_nested = [](const auto& change) { return !change.instance.below.empty(); };
        std::uint64_t bytes = 0;
        for (const AddedScene& added : changes.added) {
            const PathTable& paths = added.scene->paths();
            const std::uint64_t each = sizeof(InstanceRecord) + sizeof(InstanceInfo) + sizeof(Node) +
                                       2 * paths.node_count * sizeof(PathNode) + paths.run_count * sizeof(PathRun);
            bytes += added.scene->bytes().size() + added.to_scene.size() * each;
        }
        bytes += bytes_to_unshare(before_->snapshot(), changes);
        if (bytes != 0 || !changes.removed.empty() || !changes.deformed.empty() || std::ranges::any_of(changes.moves, is_nested) ||
            std::ranges::any_of(changes.masks, is_nested))
            bytes += before_->snapshot().bytes().size();
        if (bytes == 0) return Budget::Lease();
        auto lease = services_.budget.reserve(bytes, caller_.principal, Use::lasting);
        if (!lease)
            return services_.budget.refuse("the changed scene", bytes, caller_.principal,
                                           "unload scenes, or start raynestd with a larger --memory");
        return std::move(*lease);
    }

    /// Reads all rows into the batch.
    Reply<void> read_rows(EditBatch& batch, const Stop& stop) const {
        const Snapshot& scene = before_->snapshot();
        const std::uint32_t outermost = scene.view().objects[scene.view().root].instance_count;
        const auto no_instances = [&] {
            return refuse(Code::invalid_field,
                          fmt::format("'{}' has no instances to change: all that it has is its own. A glTF places "
                                      "its meshes by nodes, which can be edited; other scenes can be added",
                                      before_->name));
        };
        if (outermost == 0 && !order_.targets.empty()) return no_instances();
        std::vector<std::vector<InstancePlace>> named;
        InstanceFinder finder(scene, [&] { return stop.requested(); });
        for (const std::string& text : order_.targets) {
            auto found = finder.find(text);
            if (stop.requested()) return refuse(Code::cancelled, "");
            if (!found) return refuse(std::move(found.error()));
            named.push_back(std::move(*found));
        }
        // The rows' bytes are a multiple of 4 and begin where a vector of floats may.
        std::vector<std::span<const Vec3>> vertices;
        const auto* first = reinterpret_cast<const Vec3*>(rows_.bytes().data() + order_.rows * sizeof(EditRow));
        for (const std::uint32_t count : order_.vertex_counts) {
            vertices.emplace_back(first, count);
            first += count;
        }
        std::vector<InstancePlace> one(1);
        for (std::uint32_t i = 0; i < order_.rows; ++i) {
            if (i % 1024 == 0 && stop.requested()) return refuse(Code::cancelled, "");
            EditRow row;
            std::memcpy(&row, rows_.bytes().data() + i * sizeof row, sizeof row);
            const auto wrong = [&](const std::string& why) {
                return refuse(Code::invalid_field, fmt::format("row {} of the edit {}", i, why));
            };
            const bool has_matrix = row.what == EditRow::place || row.what == EditRow::move || row.what == EditRow::add;
            const auto matrix = has_matrix ? matrix_of(row) : Matrix(1);
            if (row.what >= EditRow::what_count)
                return wrong(fmt::format("does something unknown: what is {}", row.what));
            if (!matrix) return wrong("has a matrix with a number that is not finite");
            if (row.what == EditRow::vertices && row.value >= vertices.size())
                return wrong(fmt::format("names vertices {} of {}", row.value, vertices.size()));
            if (row.what == EditRow::add) {
                if (row.target >= order_.sources.size())
                    return wrong(fmt::format("adds scene {} of {}", row.target, order_.sources.size()));
                const EditOrder::Source& source = order_.sources[row.target];
                batch.add(row.target, {source.held, source.held->snapshot.get()}, source.name, *matrix, row.value);
                continue;
            }
            if ((row.what == EditRow::place || row.what == EditRow::move) && row.value >= EditRow::frame_count)
                return wrong(fmt::format("has an unknown frame: {}", row.value));
            if (row.what == EditRow::place && row.value == EditRow::own)
                return wrong("places an instance in its own frame: place it in its parent's, or move it");
            if (row.by_text != 0 && row.target >= named.size())
                return wrong(fmt::format("names target {} of {}", row.target, named.size()));
            if (row.by_text == 0 && row.target >= outermost)
                return outermost == 0 ? no_instances()
                                      : wrong(fmt::format("names the outermost instance {}; the scene has {}",
                                                          row.target, outermost));
            one.front() = row.target;
            for (const InstancePlace& place : row.by_text != 0 ? named[row.target] : one) {
                if (row.what == EditRow::vertices)
                    batch.set_vertices(place, vertices[row.value]);
                else if (auto done = apply(batch, row, *matrix, place); !done)
                    return wrong(done.error().message);
            }
        }
        return {};
    }

    static Result<void> apply(EditBatch& batch, const EditRow& row, const Matrix& matrix,
                              const InstancePlace& place) {
        switch (row.what) {
            case EditRow::set_mask: batch.set_mask(place, row.value); return {};
            case EditRow::remove: return batch.remove(place);
            case EditRow::place: return batch.place(place, matrix, static_cast<EditFrame>(row.value));
            default: batch.move(place, matrix, static_cast<EditFrame>(row.value)); return {};
        }
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
    std::optional<NamedScene> after_;
};

}  // namespace

std::uint64_t EditOrder::bytes() const {
    std::uint64_t sum = std::uint64_t{rows} * sizeof(EditRow);
    for (const std::uint32_t count : vertex_counts) sum += std::uint64_t{count} * sizeof(Vec3);
    return sum;
}

std::unique_ptr<Job> edit_job(const Services& services, const Caller& caller, EditOrder order) {
    return std::make_unique<EditJob>(services, caller, std::move(order));
}

}  // namespace raynest::server
