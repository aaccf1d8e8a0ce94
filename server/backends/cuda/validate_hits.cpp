#include "server/backends/cuda/validate_hits.h"

#include <algorithm>
#include <cstring>
#include <span>

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
           record.path < scene.objects[scene.root].placement_count;
}

/// True if this is the hit record of an any-hit query, which holds only the flag `hit`.
bool is_any_hit(const HitRecord& record) {
    HitRecord hit;
    hit.hit = 1;
    return std::memcmp(&hit, &record, sizeof hit) == 0;
}

bool is_given_up(const HitRecord& record) {
    HitRecord given_up;
    given_up.flags = hit_given_up;
    return std::memcmp(&given_up, &record, sizeof given_up) == 0;
}

/// Checks the records of one ray; `count` is its number of hits, for a multi-hit query.
bool are_possible(const SceneView& scene, Query query, std::span<const HitRecord> records,
                  std::uint32_t count) {
    const HitRecord& first = records.front();
    switch (query) {
        case query_multi:
            return count <= records.size() &&
                   std::all_of(records.begin(), records.begin() + count,
                               [&](const HitRecord& record) { return is_hit(scene, record); });
        case query_any:
            return is_miss(first) || is_any_hit(first);
        default:
            return is_miss(first) || is_hit(scene, first);
    }
}

}  // namespace

Answers validate_hits(const TraceCall& call, const SceneView& scene, Query query) {
    bool given_up = false;
    for (std::uint32_t i = 0; i < call.ray_count; ++i) {
        const std::span records(call.hits + std::size_t{i} * call.hits_max, call.hits_max);
        const std::uint32_t count = query == query_multi ? call.hit_counts[i] : 1;
        if (is_given_up(records.front()))
            given_up = true;
        else if (!are_possible(scene, query, records, count))
            return Answers::impossible;
    }
    return given_up ? Answers::given_up : Answers::possible;
}

}  // namespace raynest::server::device
