// Finds a step of a path by its name and number without a look at those beside it.
#pragma once

#include "engine/scene/lists/long_lists.h"

#include <cstdint>
#include <functional>
#include <optional>
#include <string_view>
#include <vector>

namespace raynest {

/// A step as path texts name it.
struct NamedStep {
    std::uint32_t name;    ///< offset in the scene's names, where each name stands once
    std::uint32_t number;  ///< no_id: it has none
};

/// The steps below one parent, in runs that one list of parts makes: a million of them may be one.
class StepIndex {
public:
    using StepAt = std::function<NamedStep(std::uint32_t)>;

    StepIndex(const char* names, std::uint32_t count, const StepAt& at);

    /// Returns the place of the last step with this name whose number is at most this one; with
    /// no_id, of the one that has none. `names` are those that it was made of, or a copy.
    [[nodiscard]] std::optional<std::uint32_t> find(const char* names, std::string_view name,
                                                    std::uint32_t number) const;

private:
    /// Steps of one name at neighbouring places, whose numbers follow each other.
    struct Run {
        std::uint32_t hash, name, number, place, count;
    };
    std::vector<Run> runs_;  ///< by hash, name and number
};

using StepIndices = LongLists<StepIndex>;

}  // namespace raynest
