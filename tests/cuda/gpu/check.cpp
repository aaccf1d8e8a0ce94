#include "tests/cuda/gpu/batch.h"
#include "tests/cuda/gpu/measure.h"

#include <nlohmann/json.hpp>

#include <cstring>
#include <string>
#include <utility>

namespace raynest::bench {
namespace {

/// Counts rays that differ in any byte, and rays that hit: a comparison of misses proves little.
struct CompareCounts {
    std::uint32_t differing = 0;
    std::uint32_t hitting = 0;
};

CompareCounts compare(const Question& question, const Batch& a, const Batch& b) {
    CompareCounts counts;
    for (std::uint32_t ray = 0; ray < a.count(); ++ray) {
        const auto got = a.answer(question, ray);
        const auto expected = b.answer(question, ray);
        if (got.size() != expected.size() ||
            std::memcmp(got.data(), expected.data(), expected.size_bytes()) != 0)
            ++counts.differing;
        if (!expected.empty() && expected.front().hit != 0) ++counts.hitting;
    }
    return counts;
}

}  // namespace

bool check(const OpenDevice& device, const Pack& cpu, const Work& work) {
    // Rays that the device makes are not in host memory.
    const Ray none{};
    Batch answers(work.made != nullptr ? std::span(&none, 1) : std::span(work.rays), work.count);
    Batch expected(work.rays, work.count);
    const std::string not_pinned = answers.pin(device);
    const OpenDevice::Scene scene = device.load(work.scene);
    std::vector<OpenDevice::Slot> slots;
    for (int i = 0; i < 2; ++i) {
        slots.push_back(device.make_slot(work.chunk, std::uint64_t{work.chunk} * most_hits));
    }

    bool equal = true;
    for (const PackVariant& variant :
         std::span(device.pack().variants, device.pack().variant_count)) {
        const PackVariant* const other = find_variant(cpu, variant.name);
        for (const Question& question : questions) {
            const auto of = [&](const PackVariant& from) {
                return from.trace[traversal_single][question.query][0];
            };
            if (of(variant) == nullptr) continue;
            if (other == nullptr || of(*other) == nullptr)
                throw std::runtime_error(std::string("the CPU's pack has no ") + variant.name);
            answers.forget_answers();
            run_pass({&device, &scene, of(variant), slots, work.chunk, work.made}, question,
                     answers);
            TraceCall call = expected.call(question, 0, work.count);
            call.scene = &work.scene;
            if (of(*other)(&call) != trace_ok)
                throw std::runtime_error("the CPU's pack refuses the call");
            const CompareCounts counts = compare(question, answers, expected);
            equal = equal && counts.differing == 0;
            nlohmann::ordered_json row{{"query", question.name},
                                       {"variant", variant.name},
                                       {"hitting", counts.hitting},
                                       {"differing", counts.differing}};
            if (!not_pinned.empty()) row["not_pinned"] = not_pinned;
            work.print(std::move(row));
        }
    }
    return equal;
}

}  // namespace raynest::bench
