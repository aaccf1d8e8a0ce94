// The source of a query's rays: sent by the client, or made by a generator.
#pragma once

#include "engine/integrators/generators.h"
#include "engine/queries/columns.h"
#include "server/execution/chunk_queue.h"
#include "server/execution/ray_input.h"
#include "server/jobs/sent_sweep.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <utility>
#include <variant>

namespace raynest::server {

/// A sensor that the first task constructs: a lidar's tables are too much work for the io thread.
class LateSensor {
public:
    LateSensor(ImageSize grid, std::function<Sensor()> make)
        : grid_(grid),
          make_(std::move(make)) {}
    /// One whose trajectory the client sends; get() it once that is made.
    explicit LateSensor(std::shared_ptr<SentSweep> sent)
        : grid_(sent->order().grid()),
          make_([sent] { return sent->take_sensor(); }),
          sent_(std::move(sent)) {}
    [[nodiscard]] const ImageSize& grid() const { return grid_; }
    /// Null unless the client sends a trajectory.
    [[nodiscard]] const std::shared_ptr<SentSweep>& sent() const { return sent_; }
    /// Returns the sensor; the first call constructs it. Thread-safe.
    [[nodiscard]] const Sensor& get() {
        std::call_once(once_, [this] { sensor_ = make_(); });
        return *sensor_;
    }

private:
    const ImageSize grid_;
    const std::function<Sensor()> make_;
    const std::shared_ptr<SentSweep> sent_;
    std::once_flag once_;
    std::optional<Sensor> sensor_;
};
using SensorPointer = std::shared_ptr<LateSensor>;

/// How the scene moves while a sweep is measured.
struct SceneMotion {
    std::uint32_t animation = 0;
    /// Moment of the scene at the first column of the sweep; nothing: its time in the trajectory.
    std::optional<double> seconds;
};
/// That a query traces its sweep in a scene that moves, if it has an animation.
struct MovingScene {
    std::optional<SceneMotion> scene;
};

/// The result of a generator: a sensor with all of its rays, or a hemisphere, which makes rays from
/// points that the client sends.
using Generated = std::variant<SensorPointer, Hemisphere>;

/// Makes and traces the rays of a query.
class RaySource {
public:
    /// Rays that the client sends.
    explicit RaySource(std::uint64_t rays) : rays_(rays) {}
    /// Rays [first, first + rays) of a sensor, which has as many.
    RaySource(SensorPointer sensor, std::uint64_t first, std::uint64_t rays)
        : origin_(std::move(sensor)),
          rays_(rays),
          first_(first) {}
    /// Rays from points that the client sends, whose numbers begin at `first`.
    RaySource(const Hemisphere& hemisphere, std::uint64_t first, std::uint64_t points)
        : origin_(hemisphere),
          rays_(points * hemisphere.samples),
          first_(first) {}

    /// Number of rays of the query.
    [[nodiscard]] std::uint64_t rays() const { return rays_; }
    /// Number of rays for each point that the client sends; 1 if it sends rays.
    [[nodiscard]] std::uint64_t rays_per_point() const;
    [[nodiscard]] bool has_points() const { return std::holds_alternative<Hemisphere>(origin_); }
    /// Number of rays or points that the client sends.
    [[nodiscard]] std::uint64_t sent() const {
        return std::holds_alternative<SensorPointer>(origin_) ? 0 : rays_ / rays_per_point();
    }
    /// The trajectory that the client sends; null if it sends none.
    [[nodiscard]] SentSweep* sweep() const {
        return sensor() != nullptr ? (*sensor())->sent().get() : nullptr;
    }
    /// True if a sensor makes the rays.
    [[nodiscard]] bool has_sensor() const { return sensor() != nullptr; }
    /// The sensor at a ray, by its number there. Any thread that traces its rays.
    [[nodiscard]] SensorAt sensor_at(std::uint64_t number) const {
        const SentSweep* const moving = sweep();
        return {pose_of_ray((*sensor())->get(), number),
                moving != nullptr ? moving->velocity_at(number) : Vec3(0)};
    }
    /// Nothing: the scene stands still.
    [[nodiscard]] const std::optional<MovingScene>& motion() const { return motion_; }
    /// Rays are of a sweep that is sent, and the scene moves.
    void set_motion(const MovingScene& motion) { motion_ = motion; }
    /// Number that the first ray has in its sensor.
    [[nodiscard]] std::uint64_t first() const { return first_; }
    /// Returns the rays of a task, at most `most`: whole rows of a sensor's tiles if they fit.
    [[nodiscard]] std::uint64_t chunk_rays(std::uint64_t most) const;

    /// Traces a chunk; sent rays or points are read from `input`. `any_order` allows tracing in
    /// square tiles, which is faster because the rays of a tile are coherent. Any thread.
    Traced<TracedRays> trace(const Plan& plan, const Chunk& chunk, RayInput& input,
                             const Stop& stop, TraceBuffers& buffers, bool any_order) const;
    /// Traces the rays of a sensor that have these numbers there. Any thread.
    Traced<TracedRays> trace(const Plan& plan, std::size_t backend,
                             std::span<const std::uint64_t> numbers, const Stop& stop,
                             TraceBuffers& buffers) const;

private:
    /// True if `count` rays from number `first` of the sensor on are whole rows of its tiles.
    [[nodiscard]] bool has_tiles(std::uint64_t first, std::uint64_t count) const;
    [[nodiscard]] const SensorPointer* sensor() const {
        return std::get_if<SensorPointer>(&origin_);
    }

    struct Sent {};
    std::variant<Sent, SensorPointer, Hemisphere> origin_;
    std::uint64_t rays_;
    std::uint64_t first_ = 0;  ///< number of the first ray of a sensor, or of the first point
    std::optional<MovingScene> motion_;
};

}  // namespace raynest::server
