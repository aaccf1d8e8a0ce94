// Finds the instances of an object by their user ids without a look at all of them.
#pragma once

#include "engine/geometry/views.h"
#include "engine/scene/lists/long_lists.h"

#include <cstdint>
#include <vector>

namespace raynest {

/// The user ids below one object, in runs: mostly ids ascend with the places, or are all alike.
class UidIndex {
public:
    UidIndex(const SceneView& view, const ObjectRecord& object);

    /// Appends the places of the instances that have this id, in no order.
    void find(std::uint32_t uid, std::vector<std::uint32_t>& places) const;
    /// The objects that the instances place, each once.
    [[nodiscard]] const std::vector<std::uint32_t>& objects() const { return objects_; }

private:
    /// Instance `place` + i has the id `uid` + i * step.
    struct Run {
        std::uint32_t uid, place, count, step;
        [[nodiscard]] std::uint64_t end() const {  ///< behind its largest id
            return uid + std::uint64_t{step} * (count - 1) + 1;
        }
    };
    /// Sets the ends_ of runs [first, last), as a binary tree whose root is in their middle.
    std::uint64_t mark_ends(std::size_t first, std::size_t last);
    void find(std::uint32_t uid, std::size_t first, std::size_t last,
              std::vector<std::uint32_t>& places) const;

    std::vector<Run> runs_;            ///< by uid
    std::vector<std::uint64_t> ends_;  ///< the largest end() in the tree below each
    std::vector<std::uint32_t> objects_;
};

using UidIndices = LongLists<UidIndex>;

}  // namespace raynest
