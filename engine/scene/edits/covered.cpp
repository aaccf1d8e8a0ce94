#include "engine/scene/edits/covered.h"

#include <algorithm>
#include <span>

namespace raynest {

void go_to_step(const SceneView& view, std::uint32_t object, std::size_t steps,
                std::vector<std::uint32_t>& way) {
    while (way.size() < steps) {
        const ObjectRecord& record = view.objects[object];
        if (record.instance_count != 1 || record.has_own_primitives()) return;
        way.push_back(0);
        object = view.instances[record.first_instance].object;
    }
}

std::size_t steps_of(std::string_view text) {
    return 1 + static_cast<std::size_t>(std::ranges::count(text, '/'));
}

bool CoveredInstances::enter(std::uint32_t object, std::uint64_t base, const PathRange& range,
                             std::vector<InstancePlace>& found) {
    const ObjectRecord& record = view_.objects[object];
    const std::span instances(view_.instances + record.first_instance, record.instance_count);
    // The last one that begins at or before the range is the first that it may cover.
    auto at = std::ranges::upper_bound(instances, range.first - std::min(base, range.first), {},
                                       &InstanceRecord::path_base);
    if (at != instances.begin()) --at;
    for (; at != instances.end() && base + at->path_base < range.end; ++at) {
        if (!way_.empty()) {
            if (nested_left_ == 0) return false;
            --nested_left_;
        }
        const std::uint64_t first = base + at->path_base;
        const std::uint64_t end = first + view_.objects[at->object].placement_count;
        if (end <= range.first || first == end) continue;
        way_.push_back(static_cast<std::uint32_t>(at - instances.begin()));
        bool entered = true;
        if (range.first <= first && end <= range.end) {
            const std::size_t depth = way_.size();
            go_to_step(view_, at->object, steps_, way_);
            found.emplace_back(way_.front(), std::vector(way_.begin() + 1, way_.end()));
            way_.resize(depth);
            placements_ += end - first;
        } else {
            entered = enter(at->object, first, range, found);
        }
        way_.pop_back();
        if (!entered) return false;
    }
    return true;
}

}  // namespace raynest
