// The objects that an edit copies, for they lie in several places and change at one, and their bytes.
#pragma once

#include "engine/result.h"
#include "engine/scene/edits/edit.h"
#include "engine/scene/edits/edit_guard.h"
#include "engine/scene/edits/instance_place.h"
#include "engine/scene/snapshot.h"

#include <algorithm>
#include <cstdint>
#include <map>
#include <span>
#include <utility>
#include <vector>

namespace raynest {

/// The objects and instances on a way down: indices in SceneView::objects and SceneView::instances.
struct WayStep {
    std::uint32_t object;
    std::uint32_t instance;
};

/// Returns the steps to an instance; empty if the scene lacks it.
[[nodiscard]] std::vector<WayStep> steps_to(const SceneView& view, const InstancePlace& place);

/// Returns the object of an instance that the scene has.
[[nodiscard]] std::uint32_t object_of(const SceneView& view, const InstancePlace& place);

/// The last step of a way whose last object changes, with the number of the change: objects below
/// which all ways end alike stay one object.
inline constexpr std::uint32_t alike_bit = 1U << 31;

/// Returns the ways on which shared objects change, a step longer (alike_bit) where the last one's
/// object does.
/// The scene has the instances that the changes name, and the changes keep the limits of
/// edit_scene(). Fails as the guard does.
[[nodiscard]] Result<std::vector<InstancePlace>> shared_ways(const Snapshot& scene,
                                                             const SceneChanges& changes,
                                                             const EditGuard& guard = {});

/// Goes through the objects that are copied so that those on the ways can change, each object below
/// which ways end alike once. `objects` has keep(OBJECT), for one that stays, and
/// copy(OBJECT, CHILDREN), whose children are what these returned; the root comes last. At most
/// scene_depth_max deep.
template <class Objects>
class WayCopies {
public:
    WayCopies(const SceneView& view, Objects& objects) : view_(view), objects_(objects) {}

    std::uint32_t copy(const std::vector<InstancePlace>& ways) {
        std::vector<std::vector<std::uint32_t>> whole;
        for (const InstancePlace& way : ways) {
            auto& steps = whole.emplace_back(std::vector{way.outermost});
            steps.insert(steps.end(), way.below.begin(), way.below.end());
        }
        std::ranges::sort(whole);
        return copy(view_.root, {whole.begin(), whole.end()});
    }

private:
    using Way = std::span<const std::uint32_t>;
    using Key = std::vector<std::uint32_t>;

    std::uint32_t copy(std::uint32_t object, const std::vector<Way>& ways) {
        Key key;
        if (object != view_.root &&
            std::ranges::all_of(ways, [](Way way) { return (way.back() & alike_bit) != 0; })) {
            key.push_back(object);
            for (const Way& way : ways) {
                key.push_back(static_cast<std::uint32_t>(way.size()));
                key.insert(key.end(), way.begin(), way.end());
            }
            if (const auto made = made_.find(key); made != made_.end()) return made->second;
        }
        std::map<std::uint32_t, std::vector<Way>> below;
        for (const Way& way : ways)
            if (way.size() > 1) below[way.front()].push_back(way.subspan(1));
        const ObjectRecord& record = view_.objects[object];
        std::vector<std::uint32_t> children;
        for (std::uint32_t i = 0; i < record.instance_count; ++i) {
            const std::uint32_t child = view_.instances[record.first_instance + i].object;
            const auto goes_on = below.find(i);
            children.push_back(goes_on == below.end() ? objects_.keep(child)
                                                      : copy(child, goes_on->second));
        }
        const std::uint32_t made = objects_.copy(object, children);
        if (!key.empty()) made_.emplace(std::move(key), made);
        return made;
    }

    const SceneView& view_;
    Objects& objects_;
    std::map<Key, std::uint32_t> made_;  ///< copies, by the object and the ways below it
};

/// Returns how many bytes it takes at most to copy what lies on the shared ways.
[[nodiscard]] std::uint64_t bytes_to_unshare(const Snapshot& scene,
                                             const std::vector<InstancePlace>& ways);

/// Returns how many bytes an edit takes at most while it is made, beside an edited copy of the
/// scene. Costs a look at each instance of the scene.
[[nodiscard]] std::uint64_t bytes_beside(const Snapshot& scene, const SceneChanges& changes,
                                         const std::vector<InstancePlace>& ways);

}  // namespace raynest
