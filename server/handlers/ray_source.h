// Where the rays of a query come from: the client sends them, or the daemon makes them.
#pragma once

#include "protocol/control.h"
#include "protocol/wire.h"
#include "server/errors.h"
#include "server/execution/chunk_queue.h"
#include "server/execution/ray_input.h"
#include "server/handlers/generator.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <variant>
#include <vector>

namespace raynest::server {

/// A camera of the scene, or a look-at, as a request describes it.
[[nodiscard]] CameraRequest camera_request(const wire::Camera* camera);

class RaySource {
public:
    /// INVALID_FIELD names what a generator lacks.
    static Reply<RaySource> make(const wire::Query& query, const Snapshot& scene);

    /// Rays of the query, and how many each point has that the client sends (1: it sends rays).
    [[nodiscard]] std::uint64_t rays() const { return rays_; }
    [[nodiscard]] std::uint64_t rays_per_point() const;
    [[nodiscard]] bool has_points() const { return std::holds_alternative<Hemisphere>(origin_); }
    /// Rays or points that the client sends.
    [[nodiscard]] std::uint64_t sent() const {
        return std::holds_alternative<SensorPointer>(origin_) ? 0 : rays_ / rays_per_point();
    }
    /// As many rays as a task should take: whole bands of tiles, if `most` allows.
    [[nodiscard]] std::uint64_t chunk_rays(std::uint64_t most) const;

    /// Any thread: traces a chunk, whose sent rays or points lie in `input`. With `any_order`
    /// rays may be traced among others: neighbours in square tiles are traced faster.
    Traced<TracedRays> trace(const Plan& plan, const Chunk& chunk, RayInput& input,
                             const Stop& stop, TraceBuffers& buffers, bool any_order) const;

private:
    /// Is it whole bands of tiles?
    [[nodiscard]] bool has_tiles(const Chunk& chunk) const;
    [[nodiscard]] const SensorPointer* sensor() const {
        return std::get_if<SensorPointer>(&origin_);
    }

    struct Sent {};
    std::variant<Sent, SensorPointer, Hemisphere> origin_;
    std::uint64_t rays_ = 0;
};

}  // namespace raynest::server
