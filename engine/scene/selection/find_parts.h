// The parts of a scene that texts and ids of paths stand for.
#pragma once

#include "engine/result.h"
#include "engine/scene/selection/selected_instances.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace raynest {

/// Memory of a search for texts, per outermost instance of the scene.
inline constexpr std::uint64_t search_bytes_per_instance = 128;

/// Parts within outermost instances that one list may stand for, at most.
inline constexpr std::size_t selected_parts_max = 1 << 16;

/// Names of parts of a scene.
struct PathNames {
    std::vector<std::string> texts;  ///< texts of paths, as InstanceFinder takes them
    std::vector<std::uint64_t> ids;  ///< ids of paths

    [[nodiscard]] bool empty() const { return texts.empty() && ids.empty(); }
    bool operator==(const PathNames&) const = default;
};

/// Adds what `hidden` and `only` stand for to `lists`. Fails with field_invalid for a name that the
/// scene lacks or that is in both, and with limit_exceeded beyond selected_parts_max or the limit
/// of InstanceFinder, or once `stopped` is true. Takes the time of InstanceFinder.
Result<void> find_parts(const Snapshot& scene, const PathNames& hidden, const PathNames& only,
                        const std::function<bool()>& stopped, InstanceLists& lists);

}  // namespace raynest
