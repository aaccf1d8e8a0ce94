// Where the rays of a query come from: the client sends them, or the daemon makes them.
#pragma once

#include "engine/integrators/generators.h"
#include "protocol/control.h"
#include "protocol/frame.h"
#include "protocol/wire.h"
#include "server/errors.h"
#include "server/handlers/tracing.h"
#include "server/store/budget.h"

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace raynest::server {

/// Rays as a client sends them: whole ones, or only what those of a frame do not have in common.
class SentRays {
public:
    SentRays() = default;
    /// Those of a frame, which must outlive it. INVALID_FIELD where it lacks what they need, or
    /// says of all what each ray brings.
    static Reply<SentRays> of(const protocol::Opened<wire::QueryRays>& message);

    [[nodiscard]] bool empty() const { return count() == 0; }
    [[nodiscard]] std::uint64_t count() const { return bytes_.size() / stride_; }
    /// Rays [first, first + count): where they lie, or written to `room`.
    [[nodiscard]] std::span<const Ray> rays(std::uint64_t first, std::uint64_t count,
                                            std::vector<Ray>& room) const;

private:
    std::span<const std::byte> bytes_;
    std::uint32_t stride_ = sizeof(Ray);
    Ray common_;  ///< what shorter rays do not bring
};

/// The bulk part of a frame of rays, or of points.
struct SentFrame {
    const protocol::Buffer bulk;
    const Budget::Lease lease;              ///< of what it costs beside its bulk
    std::atomic<std::uint64_t> unanswered;  ///< rays
};

/// A run of a query's rays.
struct Piece {
    std::uint64_t first = 0;
    std::uint64_t count = 0;
    std::shared_ptr<SentFrame> frame = {};  ///< that holds what follows
    SentRays sent = {};                     ///< rays, or the points they start from
    std::uint64_t sent_first = 0;           ///< of them in the query
    std::uint64_t input_bytes = 0;          ///< of the frame: due when all is answered
    std::vector<Piece> more = {};           ///< for a GPU: the rest of `count`, in other frames
    std::string fallback = {};              ///< why it is the CPU's, after a GPU gave it up

    /// Cuts off the first `rays`.
    Piece split(std::uint64_t rays) {
        Piece head = *this;
        head.count = rays;
        first += rays;
        count -= rays;
        if (count != 0) head.input_bytes = 0;
        return head;
    }
    /// Takes in what follows it.
    void append(Piece next) {
        count += next.count;
        more.push_back(std::move(next));
    }
    /// What it was appended from: each lies in one frame.
    [[nodiscard]] std::vector<Piece> parts() const {
        std::vector<Piece> all = {*this};
        all.front().more.clear();
        for (const Piece& part : more) {
            all.front().count -= part.count;
            all.push_back(part);
        }
        return all;
    }
};

/// A camera of the scene, or a look-at, as a request describes it.
[[nodiscard]] CameraRequest camera_request(const wire::Camera* camera);

/// A sensor that is made when a task first asks for it: the tables of a lidar are too much work for
/// the io thread.
class LateSensor {
public:
    LateSensor(ImageSize grid, std::function<Sensor()> make)
        : grid_(grid),
          make_(std::move(make)) {}
    [[nodiscard]] const ImageSize& grid() const { return grid_; }
    /// Thread-safe.
    [[nodiscard]] const Sensor& get() {
        std::call_once(once_, [this] { sensor_ = make_(); });
        return *sensor_;
    }

private:
    const ImageSize grid_;
    const std::function<Sensor()> make_;
    std::once_flag once_;
    std::optional<Sensor> sensor_;
};
using SensorPointer = std::shared_ptr<LateSensor>;

class RaySource {
public:
    /// INVALID_FIELD names what a generator lacks.
    static Reply<RaySource> make(const wire::Query& query, const Snapshot& scene);

    /// Rays of the query, and how many each point has that the client sends (1: it sends rays).
    [[nodiscard]] std::uint64_t rays() const { return rays_; }
    [[nodiscard]] std::uint64_t rays_per_point() const;
    [[nodiscard]] bool has_points() const { return std::holds_alternative<Hemisphere>(origin_); }
    /// Does the client send anything? Then a frame of it is this piece.
    [[nodiscard]] bool sends() const { return !std::holds_alternative<SensorPointer>(origin_); }
    /// As many rays as a task should take: whole bands of tiles, if `most` allows.
    [[nodiscard]] std::uint64_t chunk_rays(std::uint64_t most) const;

    /// Worker thread: traces a piece and gives its rays, which lie in its frame or in the buffers;
    /// the answers are in their order (TraceBuffers::order). With `any_order` rays may be traced
    /// among others: neighbours in square tiles are traced faster.
    Reply<std::span<const Ray>> trace(const Plan& plan, const Piece& piece, const Stop& stop,
                                      TraceBuffers& buffers, bool any_order) const;

private:
    [[nodiscard]] std::span<const Ray> rays_of(const Piece& piece, TraceBuffers& buffers) const;
    void generate(const Piece& piece, bool tiles, std::span<Ray> rays) const;
    /// Is it whole bands of tiles?
    [[nodiscard]] bool has_tiles(const Piece& piece) const;
    /// A piece's rays as a camera that a GPU makes them with, row by row or in tile order, where
    /// one does.
    [[nodiscard]] std::optional<PinholeRays> made(const Piece& piece, bool tiles) const;

    struct Sent {};
    std::variant<Sent, SensorPointer, Hemisphere> origin_;
    std::uint64_t rays_ = 0;
};

}  // namespace raynest::server
