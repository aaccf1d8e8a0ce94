#include "engine/scene/lists/uid_index.h"

#include <algorithm>
#include <set>
#include <tuple>

namespace raynest {

UidIndex::UidIndex(const SceneView& view, const ObjectRecord& object) {
    std::set<std::uint32_t> objects;
    for (std::uint32_t i = 0; i < object.instance_count; ++i) {
        const std::uint32_t at = object.first_instance + i;
        const std::uint32_t uid = view.instance_infos[at].uid;
        objects.insert(view.instances[at].object);
        if (!runs_.empty()) {
            Run& last = runs_.back();
            if (last.count == 1 && (uid == last.uid || uid == last.uid + 1))
                last.step = uid - last.uid;
            if (last.uid + std::uint64_t{last.step} * last.count == uid &&
                (last.count > 1 || uid - last.uid <= 1)) {
                ++last.count;
                continue;
            }
        }
        runs_.push_back({uid, i, 1, 0});
    }
    std::ranges::sort(runs_, {}, [](const Run& run) { return std::tuple(run.uid, run.place); });
    runs_.shrink_to_fit();
    for (const Run& run : runs_)
        ends_.push_back(std::max(run.end(), ends_.empty() ? 0 : ends_.back()));
    objects_.assign(objects.begin(), objects.end());
}

void UidIndex::find(std::uint32_t uid, std::vector<std::uint32_t>& places) const {
    const auto behind = std::ranges::upper_bound(runs_, uid, {}, &Run::uid);
    for (auto i = static_cast<std::size_t>(behind - runs_.begin()); i-- > 0 && ends_[i] > uid;) {
        const Run& run = runs_[i];
        if (run.step != 0) {
            if (uid - run.uid < run.count) places.push_back(run.place + (uid - run.uid));
        } else if (run.uid == uid) {
            for (std::uint32_t k = 0; k < run.count; ++k) places.push_back(run.place + k);
        }
    }
}

}  // namespace raynest
