// The columns of a query's answer, and the CHUNK frame that carries them.
#pragma once

#include "server/execution/statistics.h"

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace raynest::server {

/// The checked columns of a query: the requested fields, then all outputs of the intersector, which
/// are always sent. In multi and all queries, columns of rays (hit, flags, counters, outputs) have
/// one element per ray, the others one per hit.
class Columns {
public:
    /// Chooses the columns by name; without names, the default of the query. Fails with
    /// INVALID_FIELD on a field that kind any or all does not define. A name that is not a field
    /// may be an output of the intersector: call check_outputs() once the variant is known.
    static Reply<Columns> choose(std::span<const std::string> names, Query query);

    /// Fails with INVALID_FIELD if a name is neither a field nor an output of `variant`.
    [[nodiscard]] Reply<void> check_outputs(const Variant& variant) const;

    /// The counters that the columns need.
    [[nodiscard]] CounterMode counters() const;

    /// Fails with INVALID_FIELD if a column is of a level that the scene lacks.
    [[nodiscard]] Reply<void> check_levels(const SceneView& scene) const;

    /// True if a column needs the rays besides their hits.
    [[nodiscard]] bool read_rays() const;
    /// True if a column says how fast something moves.
    [[nodiscard]] bool read_motion() const;
    /// True if a column says where something is for the sensor.
    [[nodiscard]] bool read_sensor() const;

    /// Maximum bulk bytes of a chunk.
    struct Cost {
        std::uint64_t fixed = 0;
        std::uint64_t per_ray = 0;
        std::uint64_t per_hit = 0;  ///< 0 unless the number of hits per ray varies
        [[nodiscard]] std::uint64_t bytes(std::uint64_t rays, std::uint64_t hits) const {
            return fixed + rays * per_ray + hits * per_hit;
        }
    };
    [[nodiscard]] Cost cost(const Plan& plan) const;

    /// Encodes the CHUNK frame of `traced`, whose first ray is `first_ray` of the query. Compacts
    /// the hits of a multi query in place. Adds to `statistics`. `sensors`: one per ray, or none.
    Reply<protocol::Frame> encode(const Plan& plan, const Registry& registry, std::uint64_t id,
                                  std::uint64_t first_ray, const TracedRays& traced,
                                  JobStatistics& statistics,
                                  std::span<const SensorAt> sensors) const;

private:
    std::vector<Column> columns_;
    std::vector<std::string> outputs_;  ///< names that are not fields
};

}  // namespace raynest::server
