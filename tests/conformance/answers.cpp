#include "tests/conformance/answers.h"

#include <cstring>
#include <stdexcept>
#include <string>

namespace raynest::conformance {
namespace {

void check_call(TraceStatus status, const Variant& variant) {
    if (status != trace_ok) {
        throw std::runtime_error(variant.name + " refused a well-formed call");
    }
}

// Finds all hits with buffers as small as possible, so that calls end within the rays and continue.
Answer ask_all(const Variant& variant, TraceFunction function, TraceCall call) {
    const std::uint32_t n = call.ray_count;
    Answer answer;
    answer.counts.resize(n);
    answer.ray_flags.resize(n);
    answer.outputs.assign(variant.outputs().size(), std::vector<std::uint32_t>(n));
    std::vector<void*> columns(answer.outputs.size());
    call.outputs = columns.data();
    std::vector<HitRecord> room(std::size_t{2} * call.hits_max);
    call.hits = room.data();
    call.hits_room = room.size();
    std::uint32_t fresh = 0;
    call.rays_done = &fresh;
    for (std::uint32_t done = 0; done < n; done += fresh) {
        call.ray_count = n - done;
        call.hit_counts = answer.counts.data() + done;
        call.ray_flags = answer.ray_flags.data() + done;
        for (std::size_t i = 0; i < columns.size(); ++i)
            columns[i] = answer.outputs[i].data() + done;
        check_call(function(&call), variant);
        if (fresh == 0) {
            throw std::runtime_error(variant.name + ": the buffer is too small for ray " +
                                     std::to_string(done));
        }
        std::size_t end = 0;
        for (std::uint32_t i = done; i < done + fresh; ++i) {
            answer.first.push_back(answer.hits.size() + end);
            end += answer.counts[i];
        }
        answer.hits.insert(answer.hits.end(), room.begin(),
                           room.begin() + static_cast<std::ptrdiff_t>(end));
        call.rays += fresh;
    }
    return answer;
}

}  // namespace

Answer ask(const Variant& variant, TraceFunction function, const SceneView& scene,
           std::span<const Ray> rays, const Question& question, const Settings& settings,
           CounterMode counters) {
    const auto n = static_cast<std::uint32_t>(rays.size());
    const std::size_t sets = counters == counters_by_level ? scene.objects[scene.root].levels : 1;
    const std::uint32_t capacity = question.query == query_all ? 0 : question.hits_max;
    Answer answer;
    answer.hits.resize(static_cast<std::size_t>(n) * capacity);
    for (std::uint32_t i = 0; i < n; ++i) answer.first.push_back(std::size_t{i} * capacity);
    answer.counts.assign(n, 1);
    answer.counters.resize(n * sets);
    answer.outputs.assign(variant.outputs().size(), std::vector<std::uint32_t>(n));
    std::vector<void*> columns;
    for (auto& column : answer.outputs) columns.push_back(column.data());
    TraceCall call{};
    settings.apply_to(call);
    call.scene = &scene;
    call.rays = rays.data();
    call.ray_count = n;
    call.hits_max = question.hits_max;
    call.mask = 0xFFFFFFFFU;
    call.hits = answer.hits.data();
    call.hit_counts = answer.counts.data();
    call.counters = answer.counters.data();
    call.outputs = columns.data();
    if (question.query == query_all) return ask_all(variant, function, call);
    check_call(function(&call), variant);
    for (std::size_t i = 0; i < n; ++i) {
        Counters sum;
        for (std::size_t at = i * sets; at < (i + 1) * sets; ++at) {
#define RAYNEST_COUNTER(name, title) sum.name += answer.counters[at].name;
#define RAYNEST_SUM(...)
#include "engine/geometry/counters.def"
        }
        answer.counters[i] = sum;
    }
    answer.counters.resize(n);
    return answer;
}

bool same_bytes(std::span<const HitRecord> a, std::span<const HitRecord> b) {
    const bool both_empty = a.empty() && b.empty();  // memcmp must not get null
    return both_empty ||
           (a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size_bytes()) == 0);
}

Difference differing_rays(const Answer& a, const Answer& b) {
    Difference different;
    for (std::size_t i = 0; i < a.counts.size(); ++i) {
        bool same = a.counts[i] == b.counts[i];
        if (!a.ray_flags.empty()) same = same && a.ray_flags[i] == b.ray_flags[i];
        same = same && same_bytes(a.of(i), b.of(i));
        if (!same && different.rays++ == 0) different.first = i;
    }
    return different;
}

std::optional<std::uint64_t> compare_outputs(const Answer& a, const Answer& b,
                                             const Question& question) {
    std::uint64_t compared = 0;
    for (std::size_t i = 0; i < a.counts.size(); ++i) {
        const bool met_all = question.query == query_all     ? (b.ray_flags[i] & hit_truncated) == 0
                             : question.query == query_multi ? b.counts[i] < question.hits_max
                                                             : b.of(i).front().hit == 0;
        if (!met_all) continue;
        for (std::size_t output = 0; output < a.outputs.size(); ++output) {
            if (a.outputs[output][i] != b.outputs[output][i]) return std::nullopt;
            if (b.outputs[output][i] != 0) ++compared;
        }
    }
    return compared;
}

}  // namespace raynest::conformance
