// Sums over all that objects place, on every way down, at the cost of a look at each instance.
#pragma once

#include "engine/geometry/views.h"

#include <algorithm>
#include <cstdint>
#include <vector>

namespace raynest {

/// Returns, for each object, the sum of own(object) over it and all that it places; above 2^62 as
/// that. A scene of a few objects may have 10^15 placements: whoever walks them asks this first.
template <class Own>
std::vector<std::uint64_t> placed_sums(const SceneView& view, Own&& own) {
    constexpr std::uint64_t most = 1ULL << 62;
    std::vector<std::uint64_t> sums(view.object_count);
    // Children are stored before their parents.
    for (std::uint32_t i = 0; i < view.object_count; ++i) {
        const ObjectRecord& object = view.objects[i];
        std::uint64_t sum = own(object);
        for (std::uint32_t k = 0; k < object.instance_count; ++k)
            sum = std::min(most, sum + sums[view.instances[object.first_instance + k].object]);
        sums[i] = sum;
    }
    return sums;
}

}  // namespace raynest
