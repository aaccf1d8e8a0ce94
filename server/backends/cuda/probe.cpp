#include "server/backends/cuda/probe.h"

#include "engine/assets/builtin/builtin.h"
#include "engine/integrators/generators.h"
#include "engine/math/random.h"

#include <cstring>
#include <memory>
#include <vector>

namespace raynest::server::device {
namespace {

constexpr std::uint32_t ray_count = 2048;
constexpr std::uint32_t multi_hits = 4;
constexpr ImageSize picture{64, ray_count / 64};
constexpr const char* scene_source = "builtin:forest?trees=12&leaves=10";

Result<std::shared_ptr<const Snapshot>> probe_scene() {
    const auto description = describe_builtin(scene_source);
    if (!description) return tl::unexpected(description.error());
    return Snapshot::build(*description);
}

/// Makes rays between random points within the scene's bounds.
std::vector<Ray> random_rays(const Box& bounds) {
    Random random(1);
    const auto point = [&] {
        const Vec3 at(random.uniform(), random.uniform(), random.uniform());
        return bounds.lower + at * bounds.size();
    };
    std::vector<Ray> rays(ray_count);
    for (Ray& ray : rays) {
        ray.origin = point();
        ray.direction = point() - ray.origin;
    }
    return rays;
}

struct ProbeAnswers {
    std::vector<HitRecord> hits;
    std::vector<std::uint32_t> counts;

    explicit ProbeAnswers(std::uint32_t hits_max)
        : hits(std::size_t{ray_count} * hits_max),
          counts(ray_count) {}

    [[nodiscard]] bool same_as(const ProbeAnswers& other, std::uint32_t hits_max,
                               bool multi) const {
        for (std::size_t i = 0; i < ray_count; ++i) {
            const std::size_t count = multi ? counts[i] : 1;
            if (counts[i] != other.counts[i] || count > hits_max) return false;
            if (std::memcmp(&hits[i * hits_max], &other.hits[i * hits_max],
                            count * sizeof(HitRecord)) != 0)
                return false;
        }
        return true;
    }
};

}  // namespace

Result<void> probe(std::span<const Variant* const> variants, const ProbeTrace& trace) {
    const auto scene = probe_scene();
    if (!scene) return tl::unexpected(scene.error());
    const auto camera = choose_camera(**scene, {});
    if (!camera) return tl::unexpected(camera.error());
    const PinholeRays made{pinhole(*camera, picture), 0, true};
    const std::vector<Ray> scattered = random_rays((*scene)->bounds());
    std::vector<Ray> seen(ray_count);
    generate_tiles(made.camera, 0, seen);

    for (const Variant* variant : variants) {
        for (const Query query : {query_closest, query_any, query_multi}) {
            for (const bool camera_rays : {false, true}) {
                TraceCall call{};
                call.scene = &(*scene)->view();
                call.rays = camera_rays ? seen.data() : scattered.data();
                call.ray_count = ray_count;
                call.hits_max = query == query_multi ? multi_hits : 1;
                call.mask = 0xFFFFFFFFU;
                ProbeAnswers ours(call.hits_max);
                ProbeAnswers theirs(call.hits_max);
                const auto function = find_function(*variant, query, traversal_single);
                if (!function) return tl::unexpected(function.error());
                call.hits = ours.hits.data();
                call.hit_counts = ours.counts.data();
                if ((*function)(&call) != trace_ok)
                    return fail(ErrorCode::internal, "the probe was refused by the CPU");
                call.hits = theirs.hits.data();
                call.hit_counts = theirs.counts.data();
                if (auto done =
                        trace(*variant, query, **scene, call, camera_rays ? &made : nullptr);
                    !done)
                    return done;
                if (!ours.same_as(theirs, call.hits_max, query == query_multi))
                    return fail(ErrorCode::internal, "its answers for intersector '" +
                                                         variant->name +
                                                         "' are not those of the CPU");
            }
        }
    }
    return {};
}

}  // namespace raynest::server::device
