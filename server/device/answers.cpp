#include "server/device/answers.h"

#include <cstring>

namespace raynest::server::device {
namespace {

constexpr std::uint8_t known_flags = hit_invalid_ray | hit_truncated;

bool is_miss(const HitRecord& record) {
    HitRecord miss;
    miss.flags = record.flags;
    return (record.flags & ~known_flags) == 0 && std::memcmp(&miss, &record, sizeof miss) == 0;
}

bool is_hit(const SceneView& scene, const HitRecord& record) {
    if (record.hit != 1 || record.front > 1 || (record.flags & ~known_flags) != 0) return false;
    if (record.object >= scene.object_count) return false;
    const ObjectRecord& object = scene.objects[record.object];
    return record.triangle < object.triangle_count + object.record_count &&
           record.path < scene.objects[scene.root].leaves;
}

/// Of a query that says no more than whether there is one.
bool is_any_hit(const HitRecord& record) {
    HitRecord hit;
    hit.hit = 1;
    return std::memcmp(&hit, &record, sizeof hit) == 0;
}

}  // namespace

bool are_possible(const TraceCall& call, const SceneView& scene, Query query) {
    for (std::uint32_t i = 0; i < call.ray_count; ++i) {
        const HitRecord* const records = call.hits + std::size_t{i} * call.hits_max;
        if (query == query_multi) {
            if (call.hit_counts[i] > call.hits_max) return false;
            for (std::uint32_t k = 0; k < call.hit_counts[i]; ++k)
                if (!is_hit(scene, records[k])) return false;
        } else if (query == query_any) {
            if (!is_miss(*records) && !is_any_hit(*records)) return false;
        } else if (!is_miss(*records) && !is_hit(scene, *records)) {
            return false;
        }
    }
    return true;
}

}  // namespace raynest::server::device
