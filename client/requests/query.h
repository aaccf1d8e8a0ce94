// Runs a query: sends rays as credit allows and delivers chunks of columns in order.
#pragma once

#include "client/ground/lists.h"
#include "client/ground/progress.h"
#include "client/net/connection.h"
#include "client/requests/generator.h"
#include "client/requests/job.h"
#include "client/requests/rays.h"

#include <algorithm>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>

namespace raynest::client {

/// Rows [first_ray, first_ray + count) of the answer, one per ray unless the query reduces. The
/// columns are checked: hit columns have an element per hit, all others one per ray. `splits` has
/// count + 1 offsets into the hit columns: 0, 1, 2, ... for kinds with one hit per ray.
struct QueryChunk {
    std::uint64_t first_ray = 0;
    std::uint32_t count = 0;
    std::span<const std::uint64_t> splits;
    std::span<const protocol::BlockView> columns;  ///< without ray_splits
    WorldPoint origin{};                           ///< to add to columns of points
    std::span<const std::string> hidden{};         ///< columns that users did not ask for

    [[nodiscard]] bool shows(std::string_view column) const {
        return std::ranges::find(hidden, column) == hidden.end();
    }
};

/// Runs `request`. `rays` are its rays or the points of a hemisphere; other generators have none.
/// `consume` gets every chunk in the order of rays, and may fail. A detached request ends when its
/// last ray is sent. `trajectory` is that of a sweep (read_sent_numbers()).
Result<Outcome> run_query(Connection& connection, const wire::QueryT& request,
                          const RaySource& rays, Progress& progress,
                          const std::function<Result<void>(const QueryChunk&)>& consume,
                          std::span<const std::byte> trajectory = {});

/// Returns what passes chunks on to `consume` with the columns of a sensor beside them. `first` is the
/// sensor's ray with which the answer begins. Both must outlive it.
[[nodiscard]] std::function<Result<void>(const QueryChunk&)> with_columns(
    const SensorColumns& sensor, std::uint64_t first,
    const std::function<Result<void>(const QueryChunk&)>& consume);

/// Reads the answer of a detached query; `consume` as above.
Result<Outcome> fetch_query(Connection& connection, const wire::FetchT& request, Progress& progress,
                            const std::function<Result<void>(const QueryChunk&)>& consume);

}  // namespace raynest::client
