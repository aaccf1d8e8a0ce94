#include "engine/scene/edits/edit.h"

#include "engine/scene/edits/edited_arena.h"
#include "engine/scene/edits/names.h"
#include "engine/scene/edits/rebuild.h"
#include "engine/scene/edits/refit.h"
#include "engine/scene/edits/shared_ways.h"
#include "engine/scene/edits/view_trees.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <iterator>
#include <map>
#include <set>
#include <string>
#include <utility>

namespace raynest {
namespace {

bool is_inside(const Box& box, const Box& of) {
    return box.is_empty() || (glm::all(glm::greaterThan(box.lower, of.lower)) &&
                              glm::all(glm::lessThan(box.upper, of.upper)));
}

/// Returns the name of an instance for messages.
std::string label(const Snapshot& scene, const InstancePlace& place) {
    const SceneView& view = scene.view();
    std::uint64_t path = 0;
    std::uint32_t object = view.root;
    for (const WayStep& step : steps_to(view, place)) {
        path += view.instances[step.instance].path_base;
        object = view.instances[step.instance].object;
    }
    const std::string text = text_above(scene, path, view.objects[object].placement_count);
    return text.empty() ? fmt::format("instance {}", place.outermost) : "'" + text + "'";
}

tl::unexpected<Error> refused(const Snapshot& scene, const InstancePlace& place, const char* why) {
    return fail(ErrorCode::field_invalid, fmt::format(fmt::runtime(why), label(scene, place)));
}

/// Checks that the scene has the instances, and that each is named once.
template <class Change>
Result<void> check_places(const Snapshot& scene, const std::vector<Change>& changes) {
    const SceneView& view = scene.view();
    const std::uint32_t count = view.objects[view.root].instance_count;
    // Batches are in order, and then each place is compared with the one before it alone.
    std::set<InstancePlace> seen;
    const InstancePlace* last = nullptr;
    const bool in_order = std::ranges::is_sorted(changes, {}, &Change::instance);
    for (const Change& change : changes) {
        const InstancePlace& place = change.instance;
        if (place.outermost >= count)
            return fail(ErrorCode::field_invalid,
                        fmt::format("there is no outermost instance {}: the scene has {}",
                                    place.outermost, count));
        if (!place.below.empty() && steps_to(view, place).empty())
            return fail(ErrorCode::field_invalid, "there is no such instance within " +
                                                      label(scene, InstancePlace(place.outermost)));
        const bool again =
            in_order ? last != nullptr && *last == place : !seen.insert(place).second;
        last = &place;
        if (again) return refused(scene, place, "{} is named twice in one edit");
    }
    return {};
}

Result<void> check_moves(const Snapshot& scene, const std::vector<InstanceMove>& moves) {
    for (const InstanceMove& move : moves) {
        Transform inverse;
        if (!std::ranges::all_of(move.to_parent.m, [](float x) { return std::isfinite(x); }))
            return refused(scene, move.instance,
                           "the placement of {} has numbers that are not finite");
        if (!invert(move.to_parent, inverse))
            return refused(
                scene, move.instance,
                "the placement of {} is singular: a scale of 0 leaves no way to bring rays "
                "into its space; to hide it set its mask to 0");
    }
    return {};
}

Result<void> check_vertices(const Snapshot& scene, const std::vector<MeshVertices>& deformed) {
    const SceneView& view = scene.view();
    for (const MeshVertices& mesh : deformed) {
        const ObjectRecord& object = view.objects[object_of(view, mesh.instance)];
        const std::string name = label(scene, mesh.instance);
        if (object.triangle_count == 0)
            return fail(ErrorCode::field_invalid, name + " has no triangles of its own");
        if (scene.origin() != WorldPoint{})
            return fail(
                ErrorCode::field_invalid,
                "in a scene with an origin objects have coordinates of their own: load it again");
        const std::uint64_t count = vertex_count(view, object);
        if (mesh.vertices.positions.size() != count)
            return fail(ErrorCode::field_invalid,
                        fmt::format("{} has {} vertices, {} are given (of a glTF or an array that "
                                    "faces use few vertices of, it has those alone)",
                                    name, count, mesh.vertices.positions.size()));
        const auto is_sound = [](const Vec3& p) {
            const Vec3 reach = glm::abs(p);
            return reach.x <= coordinate_max && reach.y <= coordinate_max &&
                   reach.z <= coordinate_max;
        };
        if (const auto bad = std::ranges::find_if_not(mesh.vertices.positions, is_sound);
            bad != mesh.vertices.positions.end())
            return fail(ErrorCode::field_invalid,
                        fmt::format("vertex {} of {} is not finite or beyond 1e15",
                                    bad - mesh.vertices.positions.begin(), name));
    }
    return {};
}

Result<void> check_uids(const Snapshot& scene, const std::vector<InstanceUid>& uids) {
    if (!std::ranges::is_sorted(uids, {}, &InstanceUid::instance))
        return fail(ErrorCode::field_invalid, "the instances with user ids are not in order");
    if (scene.paths().node_count != 0 || uids.empty()) return {};
    if (nested_instances(scene.view(), uids) > nested_uids_max)
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("user ids of more than {} instances within others change: "
                                "change fewer at a time",
                                nested_uids_max));
    return {};
}

Result<void> check_materials(const Snapshot& scene, const std::vector<MeshMaterial>& changes) {
    const SceneView& view = scene.view();
    for (const MeshMaterial& change : changes) {
        if (change.material >= view.material_count)
            return fail(ErrorCode::field_invalid,
                        fmt::format("there is no material {}: the scene has {}", change.material,
                                    view.material_count));
        const std::string_view why = why_not(
            scene.shading(), view.objects[object_of(view, change.instance)], change.material);
        if (!why.empty())
            return fail(
                ErrorCode::field_invalid,
                fmt::format("{} cannot have the material '{}': {}", label(scene, change.instance),
                            view.names + view.materials[change.material].name, why));
    }
    return {};
}

std::uint32_t mask_below(const SceneView& view, std::uint32_t object) {
    const ObjectRecord& record = view.objects[object];
    std::uint32_t mask = record.has_own_primitives() ? ~0U : 0;
    for (std::uint32_t i = 0; mask != ~0U && i < record.instance_count; ++i)
        mask |= view.instances[record.first_instance + i].mask;
    return mask;
}

/// Gives instances their masks, and those above them what follows: each lets in the rays that it
/// was given and that see something inside.
void set_masks(EditedArena& arena, const std::vector<InstanceMask>& changes) {
    std::map<std::uint32_t, std::set<std::uint32_t>> above;  // instances by object, children first
    for (const InstanceMask& change : changes) {
        const std::vector<WayStep> steps = steps_to(arena.view(), change.instance);
        InstanceInfo& info = arena.info(steps.back().instance);
        info.mask = change.mask;
        arena.touch(info);
        for (const WayStep& step : steps) above[step.object].insert(step.instance);
    }
    for (const auto& [object, instances] : above) {
        for (const std::uint32_t index : instances) {
            InstanceRecord& record = arena.instance(index);
            const std::uint32_t mask =
                arena.info(index).mask & mask_below(arena.view(), record.object);
            if (std::exchange(record.mask, mask) != mask) arena.touch(record);
        }
    }
}

/// Sets the user ids of an instance and of all within it, which have objects of their own.
void set_uid(EditedArena& arena, const InstanceUid& change) {
    std::vector<InstancePlace> places = places_within(arena.view(), change.instance, ~0ULL);
    places.push_back(change.instance);
    for (const InstancePlace& place : places) {
        InstanceInfo& info = arena.info(steps_to(arena.view(), place).back().instance);
        info.uid = change.uid;
        arena.touch(info);
    }
}

/// Notes what the changes touch, for the digest of the content. Whatever changes is private to its
/// place, so what lies above it are the steps to it.
TouchedObjects touched_by(const SceneView& view, const SceneChanges& changes, bool with_uids) {
    TouchedObjects touched;
    const auto touch = [&](const InstancePlace& place) {
        if (place.below.empty())
            touched[view.root].places.push_back(place.outermost);
        else
            for (const WayStep& step : steps_to(view, place))
                touched[step.object].places.push_back(step.instance -
                                                      view.objects[step.object].first_instance);
    };
    for (const InstanceMove& move : changes.moves) touch(move.instance);
    for (const InstanceMask& mask : changes.masks) touch(mask.instance);
    for (const MeshVertices& mesh : changes.deformed) {
        touch(mesh.instance);
        touched[object_of(view, mesh.instance)].primitives = true;
    }
    for (const MeshMaterial& mesh : changes.materials) {
        touch(mesh.instance);
        touched[object_of(view, mesh.instance)].primitives = true;
    }
    if (!with_uids) return touched;
    for (const InstanceUid& uid : changes.uids) {
        touch(uid.instance);
        for (const InstancePlace& place : places_within(view, uid.instance, ~0ULL)) touch(place);
    }
    return touched;
}

/// Applies moves, masks, user ids and vertices in a copy of the arena.
Result<std::shared_ptr<const Snapshot>> change_in_place(const Snapshot& scene,
                                                        const SceneChanges& changes,
                                                        std::shared_ptr<const Snapshot> spare,
                                                        const EditGuard& guard) {
    ArenaCopy copy = changes.is_last ? ArenaCopy{scene.copy_arena(), {}}
                                     : Snapshot::copy_to_edit(scene, std::move(spare));
    EditedArena arena(std::move(copy.arena), scene.view());
    set_masks(arena, changes.masks);
    for (const CameraMove& move : changes.cameras) arena.set_camera(move.camera, move.to_world);
    for (const LightMove& move : changes.lights)
        arena.set_light(move.light, move.position, move.direction);
    if (scene.paths().node_count == 0)
        for (const InstanceUid& change : changes.uids) set_uid(arena, change);
    for (const MeshMaterial& change : changes.materials)
        set_material(arena, arena.object(object_of(arena.view(), change.instance)),
                     change.material);

    ChangesByObject places;
    const std::uint32_t root = scene.view().root;
    // Notes that what is placed by the last one of these steps moves, or something in it.
    const auto note = [&](const std::vector<WayStep>& steps, const Transform* to_parent) {
        for (std::size_t i = 0; i < steps.size(); ++i) {
            const std::uint32_t place =
                steps[i].instance - arena.object(steps[i].object).first_instance;
            places[steps[i].object].places.push_back(
                {place, i + 1 == steps.size() ? to_parent : nullptr});
        }
    };
    for (const InstanceMove& move : changes.moves) {
        if (move.instance.below.empty())
            places[root].places.push_back({move.instance.outermost, &move.to_parent});
        else
            note(steps_to(arena.view(), move.instance), &move.to_parent);
    }
    for (const MeshVertices& mesh : changes.deformed) {
        places[object_of(arena.view(), mesh.instance)].vertices = mesh.vertices;
        note(steps_to(arena.view(), mesh.instance), nullptr);
    }
    TreeKnowledge known = scene.trees_to_edit();
    const std::uint64_t opened = known.extents->opened();
    const Refitted refitted = refit(arena, places, scene.tree_costs(), known);
    if (refitted.far) {
        const auto is_far = [&](const WayStep& step) {
            const std::uint32_t first = arena.object(step.object).first_instance;
            return step.object == refitted.far->object &&
                   step.instance == first + refitted.far->place;
        };
        const auto leads_there = [&](const auto& change) {
            return std::ranges::any_of(steps_to(arena.view(), change.instance), is_far);
        };
        const auto move = std::ranges::find_if(changes.moves, leads_there);
        const InstancePlace& far =
            move != changes.moves.end()
                ? move->instance
                : std::ranges::find_if(changes.deformed, leads_there)->instance;
        return refused(scene, far, "{} would reach beyond 1e15");
    }
    // A move within the scene leaves no side of it and reaches none.
    if (!is_inside(refitted.reached, scene.bounds()))
        arena.set_bounds(vertex_bounds_after(ViewTrees(arena.view()), root,
                                             arena.view().instance_count, scene.bounds(),
                                             refitted.reached, *known.extents));

    // A pose is not edited again: its refitted meshes are worth no build.
    std::vector<std::uint32_t> grown;
    for (const auto& [index, change] : places) {
        const ObjectRecord& object = arena.object(index);
        if (can_rebuild(object) && !(changes.is_last && object.triangle_count != 0) &&
            has_grown((*known.built)[index], tree_build(object.bounds, known.shares[index]),
                      rebuild_cost_factor))
            grown.push_back(index);
    }

    BuiltArena built;
    built.edits = scene.statistics().edits;
    ++built.edits.refits;
    built.edits.nodes = refitted.nodes + known.extents->opened() - opened;
    ArenaChanges changed = arena.changed();
    TouchedObjects touched = touched_by(arena.view(), changes, scene.paths().node_count == 0);
    built.arena = arena.take();
    auto edited =
        Snapshot::open_edited(std::move(built), scene,
                              {std::move(copy.sharing), std::move(changed), std::move(known),
                               std::move(touched), !changes.uids.empty()});
    // Where there is no room for a copy, slow trees stay.
    if (!edited || grown.empty() || !guard.allows((*edited)->bytes().size())) return edited;
    return rebuild_trees(**edited, grown);
}

}  // namespace

Result<std::shared_ptr<const Snapshot>> edit_scene(const Snapshot& scene,
                                                   const SceneChanges& changes,
                                                   std::shared_ptr<const Snapshot> spare,
                                                   const EditGuard& guard) {
    if (auto known = check_places(scene, changes.moves); !known)
        return tl::unexpected(known.error());
    if (auto known = check_places(scene, changes.masks); !known)
        return tl::unexpected(known.error());
    if (auto sound = check_moves(scene, changes.moves); !sound)
        return tl::unexpected(sound.error());
    if (auto known = check_places(scene, changes.deformed); !known)
        return tl::unexpected(known.error());
    if (auto sound = check_vertices(scene, changes.deformed); !sound)
        return tl::unexpected(sound.error());
    if (auto known = check_places(scene, changes.uids); !known)
        return tl::unexpected(known.error());
    if (auto sound = check_uids(scene, changes.uids); !sound) return tl::unexpected(sound.error());
    if (auto known = check_places(scene, changes.materials); !known)
        return tl::unexpected(known.error());
    if (auto sound = check_materials(scene, changes.materials); !sound)
        return tl::unexpected(sound.error());
    const std::uint32_t count = scene.view().objects[scene.view().root].instance_count;
    if (!std::ranges::is_sorted(changes.removed, std::less_equal()) ||
        (!changes.removed.empty() && changes.removed.back() >= count))
        return fail(ErrorCode::field_invalid,
                    "the removed instances are not in order, or not in the scene");

    std::shared_ptr<const Snapshot> made;
    const auto now = [&]() -> const Snapshot& { return made ? *made : scene; };
    const auto advance = [&made](Result<std::shared_ptr<const Snapshot>> next) -> Result<void> {
        if (!next) return tl::unexpected(next.error());
        made = std::move(*next);
        return {};
    };
    const auto ways = shared_ways(scene, changes, guard);
    if (!ways) return tl::unexpected(ways.error());
    if (auto room = guard.allows(bytes_beside(scene, changes, *ways)); !room)
        return tl::unexpected(room.error());
    if (!ways->empty() || (!changes.uids.empty() && scene.paths().node_count != 0))
        if (auto done = advance(unshare(scene, *ways, changes.uids).and_then(Snapshot::open));
            !done)
            return tl::unexpected(done.error());
    if (auto on = guard.allows(0); !on) return tl::unexpected(on.error());
    if (!changes.moves.empty() || !changes.masks.empty() || !changes.deformed.empty() ||
        !changes.cameras.empty() || !changes.lights.empty() || !changes.uids.empty() ||
        !changes.materials.empty() || (changes.removed.empty() && changes.added.empty()))
        if (auto done = advance(change_in_place(now(), changes, std::move(spare), guard)); !done)
            return tl::unexpected(done.error());
    if (!changes.removed.empty() || !changes.added.empty())
        if (auto done = advance(
                link_scenes(now(), changes.removed, changes.added, guard).and_then(Snapshot::open));
            !done)
            return tl::unexpected(done.error());
    return made;
}

}  // namespace raynest
