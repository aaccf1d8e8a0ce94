// Finds a step of a path by its name and number without a look at those beside it.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
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

/// The indices of a scene's long lists, each made when it is first asked for. Thread-safe.
class StepIndices {
public:
    /// Shorter lists are read as fast.
    static constexpr std::uint32_t steps_min = 64;

    std::shared_ptr<const StepIndex> of(std::uint32_t parent, const char* names,
                                        std::uint32_t count, const StepIndex::StepAt& at);
    /// How many have been made.
    [[nodiscard]] std::size_t made() const;

private:
    mutable std::mutex mutex_;
    std::map<std::uint32_t, std::shared_ptr<const StepIndex>> by_parent_;
};

}  // namespace raynest
