// A query as a stream: rays go out as credit allows, chunks of columns come back in order.
#pragma once

#include "client/connection.h"
#include "client/job.h"
#include "client/lists.h"
#include "client/progress.h"
#include "client/rays.h"

#include <algorithm>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

/// Rows [first_ray, first_ray + count) of the answer, one per ray unless the query reduces. Columns
/// are checked: those of hits have one element per hit, all others one per ray. `splits` holds
/// count + 1 offsets into the columns of hits: of a query for one hit per ray, 0, 1, 2, ...
struct QueryChunk {
    std::uint64_t first_ray = 0;
    std::uint32_t count = 0;
    std::span<const std::uint64_t> splits;
    std::span<const protocol::BlockView> columns;  ///< ray_splits is not among them
    WorldPoint origin{};                           ///< to be added to columns of points
    std::span<const std::string> hidden{};         ///< columns that users did not ask for

    [[nodiscard]] bool shows(std::string_view column) const {
        return std::ranges::find(hidden, column) == hidden.end();
    }
};

/// Runs `request` over `rays`, which are the points of a hemisphere and none of another generator;
/// `consume` gets every chunk, in ray order, and may fail. Ends with the last ray where the request
/// is detached.
Result<Outcome> run_query(Connection& connection, const wire::QueryT& request,
                          const RaySource& rays, Progress& progress,
                          const std::function<Result<void>(const QueryChunk&)>& consume);

/// Reads the answer of a query that was detached; chunks as above.
Result<Outcome> fetch_query(Connection& connection, const wire::FetchT& request, Progress& progress,
                            const std::function<Result<void>(const QueryChunk&)>& consume);

}  // namespace raynest::client
