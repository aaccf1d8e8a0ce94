// Traces an integrator's rays on the backend of its chunk.
#pragma once

#include "engine/integrators/ray_caster.h"
#include "server/execution/trace.h"

#include <cstdint>
#include <optional>
#include <span>

namespace raynest::server {

/// The plans for the functions of RayCaster; null for functions that the integrator does not call.
struct CastPlans {
    const Plan* closest = nullptr;
    const Plan* any = nullptr;
    const Plan* counted = nullptr;
    const Plan* observed = nullptr;
    const Plan* timed = nullptr;
};

/// A RayCaster for one chunk, used on the thread that traces it. All plans have the same backends.
class ChunkCaster final : public RayCaster {
public:
    ChunkCaster(const CastPlans& plans, std::size_t backend, const Stop& stop,
                TraceBuffers& buffers)
        : plans_(plans),
          backend_(backend),
          stop_(stop),
          buffers_(buffers) {}

    bool closest(std::span<const Ray> rays, std::span<HitRecord> hits) override;
    bool closest(const PinholeRays& camera, std::span<const Ray> rays,
                 std::span<HitRecord> hits) override;
    bool occluded(std::span<const Ray> rays, std::span<std::uint8_t> answers) override;
    bool counted(std::span<const Ray> rays, std::span<HitRecord> hits,
                 std::span<Counters> counters) override;

    std::optional<double> timed(std::span<const Ray> rays, std::span<HitRecord> hits,
                                std::span<std::uint32_t> nanoseconds,
                                std::span<std::uint32_t> noise) override;

    bool observed(std::span<const Ray> rays, std::span<HitRecord> hits,
                  const Observer& observer) override;

    /// The reason why the last call failed.
    [[nodiscard]] const TraceFailure& failure() const { return failure_; }
    /// The traversal of the last successful call.
    [[nodiscard]] Traversal traversal() const { return traversal_; }

private:
    bool cast(const Plan& plan, std::span<const Ray> rays, std::span<HitRecord> hits,
              Counters* counters, const PinholeRays* camera, const Observer* observer = nullptr);

    const CastPlans plans_;
    const std::size_t backend_;
    const Stop& stop_;
    TraceBuffers& buffers_;
    TraceFailure failure_ = protocol::Error{Code::internal, "the integrator gave up", 0};
    Traversal traversal_ = traversal_single;
};

}  // namespace raynest::server
