#include "server/jobs/edit_job.h"

#include "engine/scene/edits/edit.h"
#include "engine/scene/edits/names.h"
#include "protocol/control.h"
#include "protocol/text.h"
#include "server/ground/limited_log.h"
#include "server/ground/metrics.h"
#include "server/jobs/received_file.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"

#include <array>
#include <chrono>
#include <cmath>
#include <cstring>
#include <map>
#include <optional>
#include <utility>

namespace raynest::server {
namespace {

using Matrix = std::array<double, 12>;

/// Returns the map that applies `inner` first.
Matrix compose(const Matrix& outer, const Matrix& inner) {
    Matrix made{};
    for (std::size_t row = 0; row < 3; ++row) {
        for (std::size_t column = 0; column < 4; ++column) {
            double& sum = made[4 * row + column];
            for (std::size_t k = 0; k < 3; ++k) sum += outer[4 * row + k] * inner[4 * k + column];
            if (column == 3) sum += outer[4 * row + 3];
        }
    }
    return made;
}

/// Returns a map of world coordinates as one of coordinates less the origin.
Matrix less_origin(Matrix world, const WorldPoint& origin) {
    for (std::size_t row = 0; row < 3; ++row) {
        double& moved = world[4 * row + 3];
        for (std::size_t k = 0; k < 3; ++k) moved += world[4 * row + k] * origin[k];
        moved -= origin[row];
    }
    return world;
}

/// The outermost instances that the rows name, and their new placements and masks.
struct Changed {
    std::map<std::uint32_t, Matrix> placements;
    std::map<std::uint32_t, std::uint32_t> masks;
};

class EditJob final : public Job {
public:
    EditJob(const Services& services, const Caller& caller, EditOrder order)
        : services_(services),
          id_(caller.request_id),
          caller_(caller),
          order_(std::move(order)),
          rows_(0, std::uint64_t{order_.rows} * sizeof(EditRow)) {}

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
        const auto changed = read_rows(scene, stop);
        if (!changed) return tl::unexpected(changed.error());
        std::vector<InstanceMove> moves;
        for (const auto& [instance, matrix] : changed->placements) {
            InstanceMove& move = moves.emplace_back();
            move.instance = instance;
            for (std::size_t i = 0; i < 12; ++i) move.to_scene.m[i] = static_cast<float>(matrix[i]);
        }
        std::vector<InstanceMask> masks;
        for (const auto& [instance, mask] : changed->masks) masks.push_back({instance, mask});
        if (stop.requested()) return refuse(Code::cancelled, "");
        auto edited = edit_scene(scene, moves, masks, std::move(spare_));
        if (!edited) return refuse(std::move(edited.error()));
        std::map<std::uint32_t, std::uint32_t> all(changed->masks);
        for (const auto& [instance, matrix] : changed->placements) all.emplace(instance, 0);
        instances_ = static_cast<std::uint32_t>(all.size());
        return std::move(*edited);
    }

    Reply<Changed> read_rows(const Snapshot& scene, const Stop& stop) const {
        const SceneView& view = scene.view();
        const ObjectRecord& root = view.objects[view.root];
        if (root.instance_count == 0)
            return refuse(Code::invalid_field,
                          "'" + before_->name + "' has no instances to edit: all that it has is its own. "
                          "A glTF places its meshes by nodes, which can be edited");
        std::vector<std::vector<std::uint32_t>> named;
        for (const std::string& text : order_.targets) {
            auto found = find_instances(scene, text, [&] { return stop.requested(); });
            if (stop.requested()) return refuse(Code::cancelled, "");
            if (!found) return refuse(std::move(found.error()));
            named.push_back(std::move(*found));
        }
        Changed changed;
        std::vector<std::uint32_t> one(1);
        for (std::uint32_t i = 0; i < order_.rows; ++i) {
            if (i % 1024 == 0 && stop.requested()) return refuse(Code::cancelled, "");
            EditRow row;
            std::memcpy(&row, rows_.bytes().data() + i * sizeof row, sizeof row);
            const auto wrong = [&](const std::string& why) {
                return refuse(Code::invalid_field, "row " + std::to_string(i) + " of the edit " + why);
            };
            if (row.what >= EditRow::what_count)
                return wrong("does something unknown: what is " + std::to_string(row.what));
            if (row.by_text != 0 && row.target >= named.size())
                return wrong("names target " + std::to_string(row.target) + " of " +
                             std::to_string(named.size()));
            if (row.by_text == 0 && row.target >= root.instance_count)
                return wrong("names the outermost instance " + std::to_string(row.target) +
                             "; the scene has " + std::to_string(root.instance_count));
            one[0] = row.target;
            for (const std::uint32_t instance : row.by_text != 0 ? named[row.target] : one) {
                if (row.what == EditRow::set_mask) {
                    changed.masks[instance] = row.mask;
                    continue;
                }
                Matrix matrix;
                std::memcpy(matrix.data(), row.m, sizeof row.m);
                for (const double x : matrix)
                    if (!std::isfinite(x)) return wrong("has a matrix with a number that is not finite");
                auto& placement = changed.placements.try_emplace(instance).first->second;
                if (row.what == EditRow::place) {
                    if (scene.origin() != WorldPoint{})
                        return wrong("places an instance; in a scene with an origin objects have "
                                     "coordinates of their own: move it instead");
                    placement = matrix;
                } else {
                    if (placement == Matrix{}) {
                        const Transform& now =
                            view.instance_infos[root.first_instance + instance].to_parent;
                        std::copy(now.m.begin(), now.m.end(), placement.begin());
                    }
                    placement = compose(less_origin(matrix, scene.origin()), placement);
                }
            }
        }
        return changed;
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

std::unique_ptr<Job> edit_job(const Services& services, const Caller& caller, EditOrder order) {
    return std::make_unique<EditJob>(services, caller, std::move(order));
}

}  // namespace raynest::server
