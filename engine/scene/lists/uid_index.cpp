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
    ends_.resize(runs_.size());
    mark_ends(0, runs_.size());
    objects_.assign(objects.begin(), objects.end());
}

std::uint64_t UidIndex::mark_ends(std::size_t first, std::size_t last) {
    if (first == last) return 0;
    const std::size_t middle = first + (last - first) / 2;
    ends_[middle] =
        std::max({runs_[middle].end(), mark_ends(first, middle), mark_ends(middle + 1, last)});
    return ends_[middle];
}

void UidIndex::find(std::uint32_t uid, std::vector<std::uint32_t>& places) const {
    find(uid, 0, runs_.size(), places);
}

void UidIndex::find(std::uint32_t uid, std::size_t first, std::size_t last,
                    std::vector<std::uint32_t>& places) const {
    while (first != last) {
        const std::size_t middle = first + (last - first) / 2;
        if (ends_[middle] <= uid) return;
        find(uid, first, middle, places);
        const Run& run = runs_[middle];
        if (run.uid > uid) return;
        if (run.step == 0 && run.uid == uid)
            for (std::uint32_t k = 0; k < run.count; ++k) places.push_back(run.place + k);
        else if (run.step != 0 && uid - run.uid < run.count)
            places.push_back(run.place + (uid - run.uid));
        first = middle + 1;
    }
}

}  // namespace raynest
