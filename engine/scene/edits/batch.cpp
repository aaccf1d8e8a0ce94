#include "engine/scene/edits/batch.h"

#include "engine/scene/edits/covered.h"
#include "engine/scene/edits/shared_ways.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <span>
#include <utility>

namespace raynest {
namespace {

/// Returns the map from coordinates less an origin to those of the world.
Matrix to_world(const WorldPoint& origin) {
    return translation_by(origin);
}

Matrix from_world(const WorldPoint& origin) {
    return translation_by({-origin[0], -origin[1], -origin[2]});
}

/// Calls visit(index in SceneView::instances, place of it) for each instance on the way to `place`,
/// itself last.
template <class Visit>
void walk(const SceneView& view, const InstancePlace& place, Visit&& visit) {
    std::uint32_t object = view.root;
    InstancePlace at(place.outermost);
    for (std::size_t depth = 0;; ++depth) {
        const std::uint32_t index = view.objects[object].first_instance +
                                    (depth == 0 ? place.outermost : place.below[depth - 1]);
        visit(index, at);
        if (depth == place.below.size()) return;
        object = view.instances[index].object;
        at.below.push_back(place.below[depth]);
    }
}

}  // namespace

Matrix EditBatch::placement_of(const InstancePlace& place) const {
    if (const auto known = placements_.find(place); known != placements_.end())
        return known->second;
    Matrix now(1);
    walk(scene_.view(), place, [&](std::uint32_t index, const InstancePlace&) {
        now = matrix_of(scene_.view().instance_infos[index].to_parent);
    });
    return now;
}

Matrix EditBatch::above(const InstancePlace& place) const {
    Matrix all(1);
    if (place.below.empty()) return all;
    walk(scene_.view(), place, [&](std::uint32_t, const InstancePlace& at) {
        if (at != place) all = all * placement_of(at);
    });
    return all;
}

void EditBatch::move(const InstancePlace& place, const Matrix& by, EditFrame frame) {
    const Matrix now = placement_of(place);
    Matrix& made = placements_[place];
    if (frame == EditFrame::own) {
        made = now * by;
    } else if (frame == EditFrame::parent && !place.below.empty()) {
        made = by * now;
    } else {
        const Matrix in_scene = from_world(scene_.origin()) * by * to_world(scene_.origin());
        const Matrix outer = above(place);
        made = place.below.empty() ? in_scene * now : glm::inverse(outer) * in_scene * outer * now;
    }
}

Result<void> EditBatch::place(const InstancePlace& place, const Matrix& to, EditFrame frame) {
    const bool in_world = frame == EditFrame::world || place.below.empty();
    if (in_world && scene_.origin() != WorldPoint{})
        return fail(ErrorCode::field_invalid,
                    "places an instance; in a scene with an origin objects have "
                    "coordinates of their own: move it instead");
    placements_[place] = in_world && !place.below.empty() ? glm::inverse(above(place)) * to : to;
    return {};
}

void EditBatch::set_uid(const InstancePlace& place, std::uint32_t uid) {
    const auto lies_within = [&](const InstancePlace& other) {
        return other.outermost == place.outermost && other.below.size() >= place.below.size() &&
               std::ranges::equal(place.below, std::span(other.below).first(place.below.size()));
    };
    auto said = uids_.lower_bound(place);
    while (said != uids_.end() && lies_within(said->first)) said = uids_.erase(said);
    uids_.emplace_hint(said, place, uid);
}

Result<void> EditBatch::set_material(const InstancePlace& place, std::uint32_t material) {
    const SceneView& view = scene_.view();
    if (mesh_counts_.empty()) mesh_counts_ = count_meshes(view);
    const std::uint64_t count = mesh_counts_[object_of(view, place)];
    if (count == 0)
        return fail(ErrorCode::field_invalid,
                    "gives a material to an instance without triangles of its own or within it");
    if (count > edited_meshes_max - materials_.size())
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("gives more than {} meshes a material: change fewer at a time",
                                edited_meshes_max));
    if (auto room = expect(count); !room) return room;
    for (const InstancePlace& mesh : meshes_of(view, place, mesh_counts_))
        materials_[mesh] = material;
    return {};
}

Result<void> EditBatch::remove(const InstancePlace& place) {
    if (!place.below.empty())
        return fail(ErrorCode::field_invalid,
                    "removes what lies within an instance: hide it instead, or remove "
                    "the outermost instance as a whole");
    removed_.insert(place.outermost);
    return {};
}

void EditBatch::add(std::uint32_t key, std::shared_ptr<const Snapshot> scene,
                    const std::string& name, const Matrix& placed, std::uint32_t mask) {
    AddedScene& added = added_[key];
    const Matrix to_this = turn_of(scene->up(), scene_.up()) * to_world(scene->origin());
    added.scene = std::move(scene);
    added.name = path_step_text(name);
    added.to_scene.push_back(transform_of(from_world(scene_.origin()) * placed * to_this));
    added.masks.push_back(mask);
}

Result<void> EditBatch::set_vertices(const InstancePlace& named, const NewVertices& vertices) {
    const SceneView& view = scene_.view();
    // A mesh with a material, or one that was added, stands in a group of its own.
    InstancePlace place = named;
    constexpr std::size_t any_depth = ~std::size_t{0};
    go_to_step(view, object_of(view, place), any_depth, place.below);
    const ObjectRecord& object = view.objects[object_of(view, place)];
    for (std::uint32_t i = 0; i < object.geometry_count && !vertices.normals.empty(); ++i)
        if (scene_.shading().geometries[object.first_geometry + i].normals == no_offset)
            return fail(ErrorCode::field_invalid,
                        "gives normals to a mesh that has none, or has a part without: leave them "
                        "out, or load it with normals");
    const auto bad = std::ranges::find_if_not(vertices.normals, [](const Vec3& n) {
        return std::isfinite(n.x) && std::isfinite(n.y) && std::isfinite(n.z);
    });
    if (bad != vertices.normals.end())
        return fail(ErrorCode::field_invalid,
                    fmt::format("has a normal that is not finite: number {}",
                                bad - vertices.normals.begin()));
    vertices_[place] = vertices;
    return {};
}

Result<void> EditBatch::expect(std::uint64_t more) {
    // In the maps, in the set of size() and in changes().
    constexpr std::uint64_t bytes_each = 512, at_once = 256;
    std::uint64_t all = placements_.size() + masks_.size() + vertices_.size() + uids_.size() +
                        materials_.size() + removed_.size() + more;
    for (const auto& [key, scene] : added_) all += scene.to_scene.size();
    if (all <= expected_) return {};
    const std::uint64_t asked = std::max(all - expected_, at_once);
    if (auto room = guard_.allows(asked * bytes_each); !room) return room;
    expected_ += asked;
    return {};
}

std::size_t EditBatch::size() const {
    std::set<InstancePlace> all;
    for (const auto& [place, matrix] : placements_) all.insert(place);
    for (const auto& [place, mask] : masks_) all.insert(place);
    for (const auto& [place, vertices] : vertices_) all.insert(place);
    for (const auto& [place, uid] : uids_) all.insert(place);
    for (const auto& [place, material] : materials_) all.insert(place);
    for (const std::uint32_t place : removed_) all.insert(place);
    std::size_t size = all.size();
    for (const auto& [key, scene] : added_) size += scene.to_scene.size();
    return size;
}

SceneChanges EditBatch::changes() const {
    SceneChanges made;
    for (const auto& [place, matrix] : placements_)
        made.moves.push_back({place, transform_of(matrix)});
    for (const auto& [place, mask] : masks_) made.masks.push_back({place, mask});
    for (const auto& [place, vertices] : vertices_) made.deformed.push_back({place, vertices});
    for (const auto& [place, uid] : uids_) made.uids.push_back({place, uid});
    for (const auto& [place, material] : materials_) made.materials.push_back({place, material});
    made.removed.assign(removed_.begin(), removed_.end());
    for (const auto& [key, scene] : added_) made.added.push_back(scene);
    return made;
}

}  // namespace raynest
