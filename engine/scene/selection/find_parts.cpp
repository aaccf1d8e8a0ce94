#include "engine/scene/selection/find_parts.h"

#include "engine/scene/edits/names.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace raynest {
static_assert(search_bytes_per_instance == InstanceFinder::bytes_per_instance);
namespace {

/// Adds parts to two lists: outermost instances, which may be a million, and all others.
class Parts {
public:
    Parts(const SceneView& scene, std::vector<std::uint32_t>& instances,
          std::vector<ScenePart>& parts)
        : instances_(instances),
          parts_(parts),
          is_known_(scene.objects[scene.root].instance_count) {}

    Result<void> add(ScenePart part) {
        if (part.way.size() == 1 && !part.own) {
            // Many texts may stand for the same million.
            if (!is_known_[part.way.front()]) instances_.push_back(part.way.front());
            is_known_[part.way.front()] = true;
            return {};
        }
        if (parts_.size() >= selected_parts_max)
            return fail(ErrorCode::limit_exceeded,
                        fmt::format("the paths stand for more than {} parts of instances: name "
                                    "what stands above them",
                                    selected_parts_max));
        parts_.push_back(std::move(part));
        return {};
    }

private:
    std::vector<std::uint32_t>& instances_;
    std::vector<ScenePart>& parts_;
    std::vector<bool> is_known_;
};

Result<void> find(const Snapshot& scene, const PathNames& names, InstanceFinder& finder,
                  Parts parts) {
    for (const std::string& text : names.texts) {
        auto found = finder.find_parts(text, selected_parts_max);
        if (!found) return tl::unexpected(std::move(found.error()));
        for (const InstancePlace& place : found->instances) {
            ScenePart part{{place.outermost}};
            part.way.insert(part.way.end(), place.below.begin(), place.below.end());
            if (auto added = parts.add(std::move(part)); !added) return added;
        }
        for (std::vector<std::uint32_t>& way : found->own)
            if (auto added = parts.add({std::move(way), true}); !added) return added;
    }
    for (const std::uint64_t id : names.ids) {
        auto part = part_of(scene.view(), id);
        if (!part)
            return fail(ErrorCode::field_invalid,
                        fmt::format("there is no path {}: the scene has {}", id,
                                    scene.statistics().instances));
        if (auto added = parts.add(std::move(*part)); !added) return added;
    }
    return {};
}

/// Returns the first one that is in both lists, or nothing.
template <class T>
const T* find_common(const std::vector<T>& a, std::vector<T> b) {
    std::ranges::sort(b);
    const auto found =
        std::ranges::find_if(a, [&](const T& each) { return std::ranges::binary_search(b, each); });
    return found == a.end() ? nullptr : &*found;
}

}  // namespace

Result<void> find_parts(const Snapshot& scene, const PathNames& hidden, const PathNames& only,
                        const std::function<bool()>& stopped, InstanceLists& lists) {
    const auto contradicts = [](const std::string& what) {
        return fail(ErrorCode::field_invalid,
                    "`hide` and `only` both name " + what + ": leave it out of one of them");
    };
    if (const auto* text = find_common(hidden.texts, only.texts))
        return contradicts("'" + *text + "'");
    if (const auto* id = find_common(hidden.ids, only.ids))
        return contradicts("path " + std::to_string(*id));
    lists.only_named = lists.only_named || !only.empty();
    InstanceFinder finder(scene, stopped);
    if (auto found =
            find(scene, hidden, finder, {scene.view(), lists.hidden_instances, lists.hidden_parts});
        !found)
        return found;
    return find(scene, only, finder, {scene.view(), lists.only_instances, lists.only_parts});
}

}  // namespace raynest
