// The file of Order::load_changed: what an edited scene has in place of what another has.
//
//   number of ranges (u64), their heads | the elements of each range, as in the arena
//
// Each range's elements begin at a multiple of 64 bytes. A range holds whole elements
// of one array: those that lie in a page that an edit changed.
#pragma once

#include "engine/packs/device.h"
#include "engine/result.h"
#include "engine/scene/page_set.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace raynest::server::device {

/// Most ranges of a file; scenes whose changes lie in more places are sent whole.
inline constexpr std::uint32_t changed_ranges_max = 1U << 16;

/// The head of a range.
struct RangeHead {
    std::uint32_t array = 0;  ///< SceneArray
    std::uint32_t unused = 0;
    std::uint64_t first = 0;  ///< element of the array; byte of records and attributes
    std::uint64_t count = 0;
};

/// Returns the ranges of an arena's changed arrays that lie in changed pages, in the arena's order.
std::vector<RangeHead> changed_ranges(std::span<const std::byte> arena,
                                      const ArenaChanges& changed);

/// Returns the size of the file of these ranges.
std::uint64_t changes_bytes(std::span<const RangeHead> ranges);

/// Returns that file: the ranges and their elements in `arena`.
std::vector<std::byte> changes_file(std::span<const std::byte> arena,
                                    std::span<const RangeHead> ranges);

/// Returns the ranges of a file; their elements lie in it. Fails with a text for the log if the
/// file is not exactly its ranges, or has more than changed_ranges_max, or one of no array. The
/// device knows whether a scene has such elements (packs/device.h).
Result<std::vector<ChangedRange>> read_changes(std::span<const std::byte> file);

}  // namespace raynest::server::device
