// Instances by the texts of their paths.
#pragma once

#include "engine/result.h"
#include "engine/scene/edits/instance_place.h"
#include "engine/scene/snapshot.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest {

/// Placements that the searches of a finder look at, at most, for nested instances.
inline constexpr std::uint64_t nested_placements_max = 1 << 20;

/// The parts that a text of paths stands for.
struct NamedParts {
    std::vector<InstancePlace> instances;
    /// Ways to objects of which only the own primitives have the text: places of instances,
    /// outermost first; empty for the root.
    std::vector<std::vector<std::uint32_t>> own;
};

/// Finds instances by texts of paths. `scene` must outlive it. Not thread-safe.
class InstanceFinder {
public:
    /// Searches end early, with an error, once `stopped` is true.
    InstanceFinder(const Snapshot& scene, std::function<bool()> stopped)
        : scene_(scene),
          stopped_(std::move(stopped)) {}

    /// Returns the instances, in order, that have this text, or have it above them, and which lie in
    /// no such instance themselves: of those with the same placements, the one at the last step of
    /// the text. '*' stands for any text, '/' included, as in mask rules (assets/mask_rules.h), but
    /// `a/*` for what stands in `a`, not for `a`. Fails with field_invalid where there is none, and
    /// with limit_exceeded beyond nested_placements_max. Looks at all outermost instances, the
    /// first time about 1 us each, and at the placements of those that may match in part; for a
    /// text without '*' only at what lies beside its steps, where it names whole instances.
    Result<std::vector<InstancePlace>> find(std::string_view glob);
    /// Returns all that has the text by as few instances as can be: outer ones in place of all that
    /// they place, and primitives that have the text where what lies beside them has another. Fails
    /// as find(), and with limit_exceeded for more than `nested_max` that are not outermost
    /// instances.
    Result<NamedParts> find_parts(std::string_view glob,
                                  std::size_t nested_max = nested_placements_max);

    /// Memory of a finder, per outermost instance: whoever makes one accounts for it. Texts beyond
    /// are made anew for each search.
    static constexpr std::uint64_t bytes_per_instance = 128;

private:
    Result<NamedParts> search(std::string_view glob, std::size_t nested_max, bool by_steps);
    /// The text of an outermost instance; until the next call.
    const std::string& text_of(std::uint32_t place);

    const Snapshot& scene_;
    const std::function<bool()> stopped_;
    std::vector<std::string> texts_;  ///< texts of the first outermost instances
    std::string text_;                ///< text of a later one
    std::uint64_t looked_at_ = 0;     ///< placements, by all searches
};

/// Returns the steps that the paths [path, path + count) have in common, as a text; "" if there are
/// none.
[[nodiscard]] std::string text_above(const Snapshot& scene, std::uint64_t path,
                                     std::uint64_t count);

/// True if the text, or what stands before one of its '/', is of the form of the glob.
[[nodiscard]] bool glob_matches(std::string_view glob, std::string_view text);

}  // namespace raynest
