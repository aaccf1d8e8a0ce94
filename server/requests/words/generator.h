// Generators make rays in the daemon: a kind from generators.def and its settings become a sensor.
#pragma once

#include "engine/integrators/generators.h"
#include "protocol/wire.h"
#include "server/ground/errors.h"

#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <variant>

namespace raynest::server {

/// A sensor that the first task constructs: a lidar's tables are too much work for the io thread.
class LateSensor {
public:
    LateSensor(ImageSize grid, std::function<Sensor()> make)
        : grid_(grid),
          make_(std::move(make)) {}
    [[nodiscard]] const ImageSize& grid() const { return grid_; }
    /// Returns the sensor; the first call constructs it. Thread-safe.
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

/// The result of a generator: a sensor with all of its rays, or a hemisphere, which makes rays from
/// points that the client sends.
using Generated = std::variant<SensorPointer, Hemisphere>;

/// Makes a generator. Fails with INVALID_FIELD or LIMIT_EXCEEDED, and names the setting that is
/// wrong, missing or not allowed for its kind.
Reply<Generated> generate(const wire::Generator& message, const Snapshot& scene);

}  // namespace raynest::server
