// Equal requests give equal bytes over threads, chunk sizes, traversals and targets.
//
// One scene, one list of rays that mixes camera rays, bounces and odd ones. However the list is cut
// into chunks and distributed, the bytes must be those of one call. v3 and v4 must agree; v2 has
// its own.
#include "engine/scene/snapshot.h"
#include "tests/conformance/scenes.h"
#include "tests/conformance/targets.h"
#include "tests/sanitized.h"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <map>
#include <string>
#include <thread>
#include <vector>

namespace raynest::conformance {
namespace {

constexpr std::uint32_t capacity = 4;  // hits per ray of multi
constexpr std::uint32_t ray_count = test::sanitized_share(70'000U, 10U);

struct Answer {
    std::vector<HitRecord> hits;
    std::vector<std::uint32_t> counts;

    bool operator==(const Answer& other) const {
        return counts == other.counts && hits.size() == other.hits.size() &&
               std::memcmp(hits.data(), other.hits.data(), hits.size() * sizeof(HitRecord)) == 0;
    }
};

std::vector<Ray> make_rays() {
    Random random(29);
    std::vector<Ray> rays;
    for (std::uint32_t i = 0; i < ray_count; ++i) {  // a camera, in rows
        const float x = static_cast<float>(i % 300) / 300 - 0.5F;
        const float y = static_cast<float>(i / 300) / 300 - 0.5F;
        rays.push_back({Vec3(0.1F, 0.2F, 20), 0, Vec3(x, y, -1)});
    }
    const auto bounces = random_rays(ray_count / 4, 8, random);
    const auto odd = odd_rays(ray_count / 20, 8, random);
    std::copy(bounces.begin(), bounces.end(), rays.begin() + ray_count / 2);
    std::copy(odd.begin(), odd.end(), rays.begin() + ray_count / 3);
    return rays;
}

// Threads take chunks in turn, as workers do.
Answer trace_in_chunks(TraceFunction function, const SceneView& scene, Query query,
                       const std::vector<Ray>& rays, std::uint32_t threads, std::uint32_t chunk) {
    const std::uint32_t each = query == query_multi ? capacity : 1;
    const auto n = static_cast<std::uint32_t>(rays.size());
    Answer answer{std::vector<HitRecord>(std::size_t{n} * each), std::vector<std::uint32_t>(n)};
    const auto work = [&](std::uint32_t thread) {
        for (std::uint32_t first = thread * chunk; first < n; first += threads * chunk) {
            TraceCall call{};
            call.scene = &scene;
            call.rays = rays.data() + first;
            call.ray_count = std::min(chunk, n - first);
            call.hits_max = each;
            call.mask = 0xFFFFFFFFU;
            call.hits = answer.hits.data() + std::size_t{first} * each;
            call.hit_counts = answer.counts.data() + first;
            if (function(&call) != trace_ok) std::terminate();
        }
    };
    std::vector<std::jthread> pool;
    for (std::uint32_t i = 0; i < threads; ++i) pool.emplace_back(work, i);
    pool.clear();
    // Clear what a query does not fill, so that it compares equal.
    for (std::uint32_t i = 0; query == query_multi && i < n; ++i) {
        for (std::uint32_t k = answer.counts[i]; k < each; ++k) {
            answer.hits[std::size_t{i} * each + k] = HitRecord{};
        }
    }
    return answer;
}

int main_checked() {
    const auto scene = Snapshot::build(nested_scene(3, 5));
    if (!scene) {
        std::printf("FAILED: %s\n", scene.error().message.c_str());
        return 1;
    }
    const std::vector<Ray> rays = make_rays();
    std::uint32_t compared = 0;
    std::uint32_t different = 0;
    std::map<std::string, Answer> first;
    for (const char* target : targets) {
        const auto registry = registry_of(target);
        if (registry == nullptr) continue;
        const Variant& variant = *registry->find("alpha_mask");
        for (const Query query : {query_closest, query_any, query_multi}) {
            const std::string family =
                (std::string(target) == "v2" ? "v2/" : "") + std::to_string(query);
            for (std::uint32_t t = 0; t < traversal_reference; ++t) {
                const auto function = find_function(variant, query, static_cast<Traversal>(t));
                if (!function) continue;
                for (const std::uint32_t threads : {1U, 2U, 3U, 8U}) {
                    for (const std::uint32_t chunk : {1U, 7U, 4096U, 65536U}) {
                        Answer answer = trace_in_chunks(*function, (*scene)->view(), query, rays,
                                                        threads, chunk);
                        const auto [expected, fresh] = first.try_emplace(family, answer);
                        if (fresh) continue;
                        ++compared;
                        if (answer == expected->second) continue;
                        ++different;
                        std::printf("FAILED: %s query %u traversal %u threads %u chunk %u\n",
                                    target, query, t, threads, chunk);
                    }
                }
            }
        }
    }
    std::printf("determinism: %u runs of %u rays compared, %u differ\n", compared, ray_count,
                different);
    return compared != 0 && different == 0 ? 0 : 1;
}

}  // namespace
}  // namespace raynest::conformance

int main() {
    return raynest::conformance::main_checked();
}
