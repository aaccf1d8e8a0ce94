#include "engine/bvh/node.h"
#include "tests/bench/race.h"
#include "tests/cuda/gpu/batch.h"
#include "tests/cuda/gpu/measure.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <map>
#include <span>
#include <utility>

namespace raynest::bench {
namespace {

constexpr std::uint32_t slot_counts[] = {1, 2, 4};
constexpr std::uint32_t slots_max = 4;

/// Rays go through it untouched: its root holds nothing.
struct Nothing {
    ObjectRecord root{};
    SceneView view;
    Nothing() {
        root.levels = 1;
        root.root = child_empty;
        view.objects = &root;
        view.object_count = 1;
    }
};

/// Seconds per round of every way to answer one question; all take turns.
class Race {
public:
    Race(const Question& question, Batch& batch) : question_(question), batch_(batch) {}

    void add(std::string name, const Route& route) { routes_.emplace_back(std::move(name), route); }
    void run(std::uint32_t rounds) {
        for (const auto& [name, route] : routes_) run_pass(route, question_, batch_);
        for (std::size_t turn = 0; turn < rounds * routes_.size(); ++turn) {
            // Each round starts with another one.
            const std::size_t round = turn / routes_.size();
            const auto& [name, route] = routes_[(turn + round) % routes_.size()];
            passes_[name].push_back(run_pass(route, question_, batch_));
        }
    }

    [[nodiscard]] double mrays(const std::string& name, double Pass::*seconds) const {
        std::vector<double> each;
        for (const Pass& pass : passes_.at(name)) each.push_back(pass.*seconds);
        return 1e-6 * batch_.count() / median(std::move(each));
    }
    /// Of the kernels' times, round by round.
    [[nodiscard]] double kernel_ratio(const std::string& name, const std::string& over) const {
        std::vector<double> each;
        for (std::size_t round = 0; round < passes_.at(name).size(); ++round) {
            each.push_back(passes_.at(name)[round].kernel_seconds /
                           passes_.at(over)[round].kernel_seconds);
        }
        return median(std::move(each));
    }

private:
    const Question& question_;
    Batch& batch_;
    std::vector<std::pair<std::string, Route>> routes_;
    std::map<std::string, std::vector<Pass>> passes_;
};

std::string in_flight(const std::string& name, std::uint32_t slots) {
    return name + " in " + std::to_string(slots);
}

TraceFunction kernel_of(const PackVariant& variant, const Question& question) {
    return variant.trace[precision_fast][traversal_latency][question.query][0];
}

/// The best of what copying alone allows with any number of slots.
double bus_mrays(const Race& race) {
    double best = 0;
    for (const std::uint32_t slots : slot_counts) {
        best = std::max(best, race.mrays(in_flight("bus", slots), &Pass::wall_seconds));
    }
    return best;
}

nlohmann::ordered_json row_of(const Race& race, const std::string& variant) {
    nlohmann::ordered_json row;
    const double kernel = race.mrays(variant, &Pass::kernel_seconds);
    row["kernel_mrays"] = kernel;
    row["kernel_over_opaque"] = race.kernel_ratio(variant, "opaque");
    double best = 0;
    for (const std::uint32_t slots : slot_counts) {
        const double pinned = race.mrays(in_flight(variant, slots), &Pass::wall_seconds);
        best = std::max(best, pinned);
        row["pinned_mrays"][std::to_string(slots)] = pinned;
        row["bus_mrays"][std::to_string(slots)] =
            race.mrays(in_flight("bus", slots), &Pass::wall_seconds);
    }
    row["pinned_over_limit"] = best / std::min(kernel, bus_mrays(race));
    return row;
}

}  // namespace

void time(const OpenDevice& device, const Work& work, std::uint32_t rounds) {
    Batch batch(work.rays, work.count);
    batch.pin(device);
    const OpenDevice::Scene scene = device.load(work.scene);
    const Nothing nothing;
    const OpenDevice::Scene no_scene = device.load(nothing.view);
    const auto make_slots = [&](std::uint32_t slots, std::uint32_t rays) {
        std::vector<OpenDevice::Slot> made;
        while (made.size() < slots) {
            made.push_back(device.make_slot(rays, std::uint64_t{rays} * most_hits));
        }
        return made;
    };
    const auto whole = make_slots(1, work.count);
    const auto chunks = make_slots(slots_max, work.chunk);

    const std::span variants(device.pack().variants, device.pack().variant_count);
    const PackVariant* const opaque = find_variant(device.pack(), "opaque");
    if (opaque == nullptr) throw std::runtime_error("the device's pack has no opaque");
    for (const Question& question : questions) {
        Race race(question, batch);
        const auto add_slots = [&](const std::string& name, const OpenDevice::Scene& through,
                                   TraceFunction kernel) {
            for (const std::uint32_t slots : slot_counts) {
                race.add(in_flight(name, slots),
                         {&device, &through, kernel, std::span(chunks).first(slots), work.chunk});
            }
        };
        std::vector<std::string> names;
        for (const PackVariant& variant : variants) {
            const TraceFunction kernel = kernel_of(variant, question);
            if (kernel == nullptr) continue;
            names.emplace_back(variant.name);
            race.add(variant.name, {&device, &scene, kernel, whole, work.count});
            add_slots(variant.name, scene, kernel);
        }
        add_slots("bus", no_scene, kernel_of(*opaque, question));
        race.run(rounds);
        for (const std::string& name : names) {
            nlohmann::ordered_json row{{"query", question.name},
                                       {"variant", name},
                                       {"rounds", rounds},
                                       {"chunk", work.chunk}};
            row.update(row_of(race, name));
            work.print(std::move(row));
        }
    }
}

}  // namespace raynest::bench
