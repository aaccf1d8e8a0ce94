// Which columns a query answers, and the CHUNK frame that carries them.
#pragma once

#include "server/execution/statistics.h"

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace raynest::server {

/// The columns of a query, checked: fields of the engine, then the intersector's outputs, which
/// always come back, asked for by name or not. In multi and all queries what belongs to a ray (hit,
/// flags, counters, outputs) has one element per ray, what belongs to a hit one per hit.
class Columns {
public:
    /// `names` empty: the default of the query. INVALID_FIELD names what is not defined for `any`,
    /// whose surface depends on the traversal. What is no field may be an output of the
    /// intersector: check_outputs() tells, once it is known which one runs.
    static Reply<Columns> choose(std::span<const std::string> names, Query query);

    /// INVALID_FIELD when a name is neither a field nor an output of `variant`.
    [[nodiscard]] Reply<void> check_outputs(const Variant& variant) const;

    /// Does any column need a counting function?
    [[nodiscard]] bool counting() const;

    /// Does any column need the rays beside their hits?
    [[nodiscard]] bool read_rays() const;

    /// Bulk bytes of a chunk at most.
    struct Cost {
        std::uint64_t fixed = 0;
        std::uint64_t per_ray = 0;
        std::uint64_t per_hit = 0;  ///< where a ray has any number of hits
        [[nodiscard]] std::uint64_t bytes(std::uint64_t rays, std::uint64_t hits) const {
            return fixed + rays * per_ray + hits * per_hit;
        }
    };
    [[nodiscard]] Cost cost(const Plan& plan) const;

    /// The answer to `traced` rays, which lie at `first_ray` of the query. Compacts the hits of a
    /// multi query in place. Adds to `statistics`.
    Reply<protocol::Frame> encode(const Plan& plan, const Registry& registry, std::uint64_t id,
                                  std::uint64_t first_ray, const TracedRays& traced,
                                  JobStatistics& statistics) const;

private:
    std::vector<Field> fields_;
    std::vector<std::string> outputs_;  ///< names that are no field
};

}  // namespace raynest::server
