#include "server/jobs/edit_rows.h"

#include "engine/scene/edits/edit.h"
#include "engine/scene/edits/names.h"
#include "engine/scene/edits/uid_finder.h"
#include "engine/scene/snapshot.h"
#include "protocol/text.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <functional>
#include <map>
#include <optional>
#include <ranges>
#include <string_view>
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

Result<void> apply(EditBatch& batch, const EditRow& row, const Matrix& matrix,
                   std::uint32_t material, const InstancePlace& place) {
    switch (row.what) {
        case EditRow::set_mask:
            batch.set_mask(place, row.value);
            return {};
        case EditRow::set_uid:
            batch.set_uid(place, row.value);
            return {};
        case EditRow::set_material:
            return batch.set_material(place, material);
        case EditRow::remove:
            return batch.remove(place);
        case EditRow::place:
            return batch.place(place, matrix, static_cast<EditFrame>(row.value));
        default:
            batch.move(place, matrix, static_cast<EditFrame>(row.value));
            return {};
    }
}

/// Memory of NamedPlaces, per outermost instance: its finder's, and the places that it keeps.
constexpr std::uint64_t finder_bytes_each =
    InstanceFinder::bytes_per_instance + 2 * sizeof(InstancePlace);

std::function<bool()> stop_of(const EditGuard& guard) {
    return guard.stopped ? guard.stopped : [] { return false; };
}

/// The instances that texts stand for, each text sought when it is needed. Not thread-safe.
class NamedPlaces {
public:
    NamedPlaces(const Snapshot& scene, const std::vector<std::string>& texts,
                const EditGuard& guard)
        : texts_(texts),
          finder_(scene, stop_of(guard)),
          most_(2ULL * scene.view().objects[scene.view().root].instance_count +
                nested_placements_max),
          found_(texts.size()) {}

    /// Until the next call.
    Result<const std::vector<InstancePlace>*> of(std::uint32_t text) {
        if (!found_[text]) {
            auto found = finder_.find(texts_[text]);
            if (!found) return tl::unexpected(std::move(found.error()));
            kept_ += found->size();
            // Rows mostly name their own texts: what was found may be sought again.
            if (kept_ > most_) {
                for (auto& each : found_) each.reset();
                kept_ = found->size();
            }
            found_[text] = std::move(*found);
        }
        return &*found_[text];
    }

private:
    const std::vector<std::string>& texts_;
    InstanceFinder finder_;
    const std::uint64_t most_;  ///< instances that are kept
    std::uint64_t kept_ = 0;
    std::vector<std::optional<std::vector<InstancePlace>>> found_;
};

EditRow row_at(std::span<const std::byte> bytes, std::uint32_t i) {
    EditRow row;
    std::memcpy(&row, bytes.data() + i * sizeof row, sizeof row);
    return row;
}

/// The instances that have the user ids of the rows' targets.
struct UidPlaces {
    std::vector<std::uint32_t> uids;  ///< ascending
    std::vector<std::vector<InstancePlace>> found;

    [[nodiscard]] const std::vector<InstancePlace>& of(std::uint32_t uid) const {
        return found[static_cast<std::size_t>(std::ranges::lower_bound(uids, uid) - uids.begin())];
    }
};

Result<UidPlaces> places_by_uid(const Snapshot& scene, std::uint32_t rows,
                                std::span<const std::byte> bytes, const EditGuard& guard) {
    constexpr std::uint64_t bytes_each =
        sizeof(InstancePlace) + sizeof(std::vector<InstancePlace>) + 2 * sizeof(std::uint32_t);
    UidPlaces places;
    const auto has_uid = [&](std::uint32_t i) {
        const EditRow row = row_at(bytes, i);
        return row.by == EditRow::uid && row.what != EditRow::add;
    };
    const auto numbers = std::views::iota(std::uint32_t{0}, rows);
    if (std::ranges::none_of(numbers, has_uid)) return places;
    const SceneView& view = scene.view();
    const std::uint64_t most =
        rows + std::uint64_t{view.objects[view.root].instance_count} + view.object_count;
    if (auto room = guard.allows(most * bytes_each); !room) return tl::unexpected(room.error());
    for (const std::uint32_t i : numbers)
        if (has_uid(i)) places.uids.push_back(row_at(bytes, i).target);
    std::ranges::sort(places.uids);
    const auto doubles = std::ranges::unique(places.uids);
    places.uids.erase(doubles.begin(), doubles.end());
    auto found = find_uids(scene, places.uids, stop_of(guard));
    if (!found) return tl::unexpected(std::move(found.error()));
    places.found = std::move(*found);
    return places;
}

}  // namespace

Reply<void> read_edit(EditBatch& batch, const Snapshot& scene, const std::string& name,
                      const EditContent& content, std::span<const std::byte> bytes,
                      const EditGuard& guard) {
    const std::uint32_t outermost = scene.view().objects[scene.view().root].instance_count;
    const auto no_instances = [&] {
        const SceneView& view = scene.view();
        return refuse(
            Code::invalid_field,
            fmt::format(
                "'{}' has no instances to change: {}", name,
                view.objects[view.root].has_own_primitives()
                    ? "all that it has is its own. A glTF places its meshes by nodes, which "
                      "can be edited; load a composition that places this scene's file, or "
                      "add it to another scene"
                    : "it is empty"));
    };
    if (outermost == 0 && !content.targets.empty()) return no_instances();
    if (!content.targets.empty())
        if (auto room = guard.allows(outermost * finder_bytes_each); !room)
            return refuse(room.error());
    NamedPlaces named(scene, content.targets, guard);
    const auto by_uid = places_by_uid(scene, content.rows, bytes, guard);
    if (guard.is_stopped()) return refuse(Code::cancelled, "");
    if (!by_uid) return refuse(by_uid.error());
    // The rows' bytes are a multiple of 4 and begin where a vector of floats may.
    std::vector<NewVertices> vertices;
    const auto* next = reinterpret_cast<const Vec3*>(bytes.data() + content.rows * sizeof(EditRow));
    const auto take = [&](std::uint32_t count) {
        return std::span(std::exchange(next, next + count), count);
    };
    for (std::size_t i = 0; i < content.vertex_counts.size(); ++i) {
        NewVertices& mesh = vertices.emplace_back(NewVertices{take(content.vertex_counts[i])});
        if (!content.normal_counts.empty()) mesh.normals = take(content.normal_counts[i]);
    }
    std::vector<InstancePlace> one(1);
    std::uint64_t changed = 0;
    for (std::uint32_t i = 0; i < content.rows; ++i) {
        if (i % 1024 == 0 && guard.is_stopped()) return refuse(Code::cancelled, "");
        const EditRow row = row_at(bytes, i);
        const auto wrong = [&](const std::string& why) {
            return refuse(Code::invalid_field, fmt::format("row {} of the edit {}", i, why));
        };
        const bool has_matrix =
            row.what == EditRow::place || row.what == EditRow::move || row.what == EditRow::add;
        const auto matrix = has_matrix ? matrix_of(row) : Matrix(1);
        if (row.what >= EditRow::what_count)
            return wrong(fmt::format("does something unknown: what is {}", row.what));
        if (!matrix) return wrong("has a matrix with a number that is not finite");
        if (row.what == EditRow::vertices && row.value >= vertices.size())
            return wrong(fmt::format("names vertices {} of {}", row.value, vertices.size()));
        if (row.what == EditRow::set_uid && row.value == no_id)
            return wrong(fmt::format("gives the user id {}, which stands for none", no_id));
        if (row.what == EditRow::add) {
            if (row.target >= content.sources.size())
                return wrong(
                    fmt::format("adds scene {} of {}", row.target, content.sources.size()));
            if (auto room = batch.expect(1); !room) return refuse(room.error());
            const EditContent::Source& source = content.sources[row.target];
            batch.add(row.target, {source.held, source.held->snapshot.get()}, source.name, *matrix,
                      row.value);
            continue;
        }
        if ((row.what == EditRow::place || row.what == EditRow::move) &&
            row.value >= EditRow::frame_count)
            return wrong(fmt::format("has an unknown frame: {}", row.value));
        if (row.what == EditRow::place && row.value == EditRow::own)
            return wrong(
                "places an instance in its own frame: place it in its parent's, or move it");
        if (row.by >= EditRow::by_count)
            return wrong(fmt::format("names its target in an unknown way: by is {}", row.by));
        if (row.by == EditRow::text && row.target >= content.targets.size())
            return wrong(fmt::format("names target {} of {}", row.target, content.targets.size()));
        if (row.by == EditRow::uid && by_uid->of(row.target).empty())
            return outermost == 0 ? no_instances()
                                  : wrong(fmt::format("names the user id {}, which no instance has",
                                                      row.target));
        if (row.by == EditRow::number && row.target >= outermost)
            return outermost == 0
                       ? no_instances()
                       : wrong(fmt::format("names the outermost instance {}; the scene has {}",
                                           row.target, outermost));
        std::uint32_t material = no_id;
        if (row.what == EditRow::set_material) {
            if (row.value >= content.materials.size())
                return wrong(
                    fmt::format("names material {} of {}", row.value, content.materials.size()));
            const auto found = find_material(scene.view(), content.materials[row.value]);
            if (!found) return wrong(found.error().message);
            material = *found;
        }
        one.front() = row.target;
        const std::vector<InstancePlace>* places = &one;
        if (row.by == EditRow::uid) places = &by_uid->of(row.target);
        if (row.by == EditRow::text) {
            const auto found = named.of(row.target);
            if (guard.is_stopped()) return refuse(Code::cancelled, "");
            if (!found) return refuse(found.error());
            places = *found;
        }
        if (auto room = batch.expect(places->size()); !room) return refuse(room.error());
        for (const InstancePlace& place : *places) {
            // A row may stand for a million instances.
            if (++changed % 1024 == 0 && guard.is_stopped()) return refuse(Code::cancelled, "");
            if (auto done = row.what == EditRow::vertices
                                ? batch.set_vertices(place, vertices[row.value])
                                : apply(batch, row, *matrix, material, place);
                !done)
                return done.error().code == ErrorCode::out_of_memory ? refuse(done.error())
                                                                     : wrong(done.error().message);
        }
    }
    return {};
}

std::string edit_summary(const Snapshot& scene, const EditContent& content,
                         std::span<const std::byte> bytes) {
    constexpr std::size_t named_max = 3;
    constexpr std::size_t name_bytes_most = 60;
    constexpr std::array<const char*, EditRow::what_count> verbs = {"moved",
                                                                    "moved",
                                                                    "changed the mask of",
                                                                    "removed",
                                                                    "added",
                                                                    "changed the shape of",
                                                                    "changed the user id of",
                                                                    "changed the material of"};
    struct Changed {
        std::vector<std::string> names;
        std::size_t more = 0;
    };
    std::map<std::string_view, Changed> changes;  // by verb
    const auto name_of = [&](const EditRow& row) {
        if (row.what == EditRow::add) return content.sources[row.target].name;
        if (row.by == EditRow::text) return content.targets[row.target];
        if (row.by == EditRow::uid) return fmt::format("user id {}", row.target);
        const SceneView& view = scene.view();
        const ObjectRecord& root = view.objects[view.root];
        const auto steps =
            expand_path(scene, view.instances[root.first_instance + row.target].path_base);
        return steps ? steps->front().name : fmt::format("instance {}", row.target);
    };
    for (std::uint32_t i = 0; i < content.rows; ++i) {
        const EditRow row = row_at(bytes, i);
        Changed& changed = changes[verbs[row.what]];
        if (changed.names.size() == named_max) {
            ++changed.more;
            continue;
        }
        std::string name = protocol::clean_text(name_of(row), name_bytes_most);
        if (std::ranges::find(changed.names, name) == changed.names.end())
            changed.names.push_back(std::move(name));
    }
    std::string summary;
    for (const auto& [verb, changed] : changes)
        summary += fmt::format("{}{} {}{}", summary.empty() ? "" : "; ", verb,
                               fmt::join(changed.names, ", "),
                               changed.more == 0 ? "" : fmt::format(" and {} more", changed.more));
    return summary;
}

bool gives(const Snapshot& scene, const std::string& digest) {
    return scene.digest() == digest || scene.arena_digest() == digest;
}

Reply<std::shared_ptr<const Snapshot>> replay_edits(std::shared_ptr<const Snapshot> scene,
                                                    std::uint64_t epoch,
                                                    const std::vector<KeptEdit>& edits,
                                                    const EditGuard& guard) {
    if (auto gap = gap_in(edits, epoch); !gap.empty()) return refuse(Code::scene_invalid, gap);
    std::shared_ptr<const Snapshot> spare;
    for (const KeptEdit& edit : edits) {
        const auto damaged = [&](const std::string& why) {
            return refuse(Code::scene_invalid,
                          fmt::format("its edit of epoch {} {}", edit.epoch, why));
        };
        const auto change = read_change(edit);
        if (!change) return damaged(change.error().message);
        EditBatch batch(*scene, guard);
        const auto stopped = [&] {
            return refuse(Code::cancelled, "its edits were stopped half-way");
        };
        if (auto read = read_edit(batch, *scene, "kept", change->content, change->bytes, guard);
            guard.is_stopped())
            return stopped();
        else if (!read && read.error().code == Code::resource_exhausted)
            return tl::unexpected(read.error());
        else if (!read)
            return damaged("does not fit it: " + read.error().message);
        auto edited = edit_scene(*scene, batch.changes(), std::exchange(spare, nullptr), guard);
        if (guard.is_stopped()) return stopped();
        if (!edited && edited.error().code == ErrorCode::out_of_memory)
            return refuse(edited.error());
        if (!edited) return damaged("does not fit it: " + edited.error().message);
        spare = std::exchange(scene, std::move(*edited));
        if (!gives(*scene, edit.digest)) return damaged("gives another scene than before");
    }
    return scene;
}

}  // namespace raynest::server
