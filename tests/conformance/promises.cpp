#include "tests/conformance/promises.h"

#include <algorithm>
#include <cmath>
#include <iterator>

namespace raynest::conformance {
namespace {

bool is_miss(const HitRecord& record, std::uint8_t flags) {
    HitRecord miss;
    miss.flags = flags;
    return same_bytes({&record, 1}, {&miss, 1});
}

bool is_list(Query query) {
    return query == query_multi || query == query_all;
}

bool is_inside(const Ray& ray, const HitRecord& hit) {
    return std::isfinite(hit.t) && hit.t > ray.tmin && hit.t <= ray.tmax;
}

bool is_surface(const HitRecord& hit) {
    const auto in_unit = [](float x) { return x >= 0 && x <= 1; };
    return in_unit(hit.u) && in_unit(hit.v) && hit.triangle != no_id && hit.object != no_id &&
           hit.path != no_path;
}

}  // namespace

const char* broken_promise(const Ray& ray, std::size_t i, const Question& question,
                           const Answer& answer) {
    const Query query = question.query;
    const auto hits = answer.of(i);
    if (!is_valid(ray)) {
        const bool flagged =
            query == query_multi || (query == query_all ? answer.ray_flags[i] == hit_invalid_ray
                                                        : is_miss(hits.front(), hit_invalid_ray));
        const bool missed = !is_list(query) || hits.empty();
        return flagged && missed ? nullptr : "an invalid ray is not a flagged miss";
    }
    if (query == query_any) {
        HitRecord record = hits.front();
        record.hit = 0;
        return is_miss(record, 0) ? nullptr : "the record of `any` holds more than hit or miss";
    }
    if (!is_list(query) && hits.front().hit == 0) {
        return is_miss(hits.front(), 0) ? nullptr : "a miss is not the canonical miss";
    }
    for (const HitRecord& hit : hits) {
        if (hit.hit != 1 || hit.flags != 0) return "a listed hit is not a hit";
        if (!is_inside(ray, hit)) return "t lies outside (tmin, tmax]";
        if (!is_surface(hit)) return "a hit is not on a surface";
    }
    const auto unordered =
        std::adjacent_find(hits.begin(), hits.end(),
                           [](const HitRecord& a, const HitRecord& b) { return !a.before(b); });
    return unordered == hits.end() ? nullptr : "hits are out of order";
}

const char* contradiction(std::span<const Answer> answers, std::size_t i) {
    const auto all = answers.back().of(i);
    if (answers.back().ray_flags[i] != 0) return nullptr;  // invalid, or too many to compare with
    for (std::size_t q = 0; q < answers.size(); ++q) {
        const Question& question = questions[q];
        const auto hits = answers[q].of(i);
        if (!is_list(question.query) && (hits.front().hit != 0) != !all.empty()) {
            return "one query hits and another one misses";
        }
        if (question.query == query_any || (all.empty() && !is_list(question.query))) continue;
        const auto first = all.first(std::min<std::size_t>(all.size(), question.hits_max));
        if (!same_bytes(hits, first)) return "a query's hits are not the first hits of `all`";
        if (question.query == query_all &&
            (answers[q].ray_flags[i] == hit_truncated) != (all.size() > question.hits_max)) {
            return "the wrong ray is marked truncated";
        }
    }
    return nullptr;
}

}  // namespace raynest::conformance
