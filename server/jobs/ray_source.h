// The source of a query's rays: sent by the client, or made by a generator.
#pragma once

#include "protocol/control.h"
#include "protocol/wire.h"
#include "server/ground/errors.h"
#include "server/execution/chunk_queue.h"
#include "server/execution/ray_input.h"
#include "server/requests/words/generator.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <variant>
#include <vector>

namespace raynest::server {

/// Converts a request's camera: a camera of the scene, or a look-at.
[[nodiscard]] CameraRequest camera_request(const wire::Camera* camera);

/// Makes and traces the rays of a query.
class RaySource {
public:
    /// Fails with INVALID_FIELD if the generator lacks a setting, points or its kind.
    static Reply<RaySource> make(const wire::Query& query, const Snapshot& scene);

    /// Number of rays of the query.
    [[nodiscard]] std::uint64_t rays() const { return rays_; }
    /// Number of rays for each point that the client sends; 1 if it sends rays.
    [[nodiscard]] std::uint64_t rays_per_point() const;
    [[nodiscard]] bool has_points() const { return std::holds_alternative<Hemisphere>(origin_); }
    /// Number of rays or points that the client sends.
    [[nodiscard]] std::uint64_t sent() const {
        return std::holds_alternative<SensorPointer>(origin_) ? 0 : rays_ / rays_per_point();
    }
    /// Returns the rays of a task, at most `most`: whole rows of a sensor's tiles if they fit.
    [[nodiscard]] std::uint64_t chunk_rays(std::uint64_t most) const;

    /// Traces a chunk; sent rays or points are read from `input`. `any_order` allows tracing in
    /// square tiles, which is faster because the rays of a tile are coherent. Any thread.
    Traced<TracedRays> trace(const Plan& plan, const Chunk& chunk, RayInput& input,
                             const Stop& stop, TraceBuffers& buffers, bool any_order) const;

private:
    /// True if the chunk consists of whole rows of a sensor's tiles.
    [[nodiscard]] bool has_tiles(const Chunk& chunk) const;
    [[nodiscard]] const SensorPointer* sensor() const {
        return std::get_if<SensorPointer>(&origin_);
    }

    struct Sent {};
    std::variant<Sent, SensorPointer, Hemisphere> origin_;
    std::uint64_t rays_ = 0;
};

}  // namespace raynest::server
