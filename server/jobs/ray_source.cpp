#include "server/jobs/ray_source.h"

#include <cstddef>

namespace raynest::server {
namespace {

constexpr std::uint64_t tile_rows = 8;  // tile_order(), integrators/camera.h

}  // namespace

std::uint64_t RaySource::rays_per_point() const {
    const auto* hemisphere = std::get_if<Hemisphere>(&origin_);
    return hemisphere != nullptr ? hemisphere->samples : 1;
}

std::uint64_t RaySource::chunk_rays(std::uint64_t most) const {
    const std::uint64_t band = sensor() != nullptr ? tile_rows * (*sensor())->grid().width : 0;
    return band == 0 || band > most ? most : most / band * band;
}

bool RaySource::has_tiles(std::uint64_t first, std::uint64_t count) const {
    if (sensor() == nullptr) return false;
    const ImageSize grid = (*sensor())->grid();
    const std::uint64_t band = tile_rows * grid.width;
    const bool to_the_end = first + count == grid.pixels();
    return first % band == 0 && (count % band == 0 || to_the_end);
}

Traced<TracedRays> RaySource::trace(const Plan& plan, const Chunk& chunk, RayInput& input,
                                    const Stop& stop, TraceBuffers& buffers, bool any_order) const {
    const SensorPointer* made_by = sensor();
    if (made_by == nullptr) {
        const auto* hemisphere = std::get_if<Hemisphere>(&origin_);
        const auto masks = input.masks(chunk.first, chunk.count, buffers);
        if (!masks) return tl::unexpected(TraceFailure(masks.error()));
        const auto trace = [&](std::span<const Ray> rays) {
            return masks->empty()
                       ? trace_rays(plan, chunk.backend, rays, stop, buffers)
                       : trace_masked_rays(plan, chunk.backend, rays, *masks, stop, buffers);
        };
        if (hemisphere == nullptr) return trace(input.sent(chunk.first, chunk.count, buffers));
        const std::uint64_t first = chunk.first / hemisphere->samples;
        const std::uint64_t last = (chunk.first + chunk.count - 1) / hemisphere->samples;
        const auto points = input.sent(first, last - first + 1, buffers);
        buffers.resize(buffers.rays, chunk.count);
        generate_rays(*hemisphere, points, first_ + first,
                      first_ * hemisphere->samples + chunk.first, buffers.rays);
        return trace(buffers.rays);
    }

    LateSensor& late = **made_by;
    const Sensor& from = late.get();
    const std::uint64_t first = first_ + chunk.first;
    const bool tiles = any_order && has_tiles(first, chunk.count);
    const auto generate = [&] {
        tiles ? generate_tiles(from, first, buffers.rays)
              : generate_rays(from, first, buffers.rays);
    };
    buffers.resize(buffers.rays, chunk.count);
    std::optional<PinholeRays> camera;
    const auto* pinhole = std::get_if<Pinhole>(&from);
    if (pinhole != nullptr && plan.backends.order[chunk.backend]->makes_camera_rays())
        camera = PinholeRays{*pinhole, first, tiles};
    if (!camera) generate();
    auto traced =
        trace_rays(plan, chunk.backend, buffers.rays, stop, buffers, camera ? &*camera : nullptr);
    if (!traced) return traced;
    if (camera && plan.reads_rays) generate();
    if (tiles) {
        const ImageSize size = late.grid();
        buffers.resize(buffers.order, chunk.count);
        for_each_in_tiles(first, chunk.count, size.width, size.height,
                          [&](std::uint64_t i, std::uint64_t x, std::uint64_t y) {
                              buffers.order[y * size.width + x - first] =
                                  static_cast<std::uint32_t>(i);
                          });
        traced->order = buffers.order;
    }
    return traced;
}

Traced<TracedRays> RaySource::trace(const Plan& plan, std::size_t backend,
                                    std::span<const std::uint64_t> numbers, const Stop& stop,
                                    TraceBuffers& buffers) const {
    buffers.resize(buffers.rays, numbers.size());
    generate_rays((*sensor())->get(), numbers, buffers.rays);
    return trace_rays(plan, backend, buffers.rays, stop, buffers);
}

}  // namespace raynest::server
