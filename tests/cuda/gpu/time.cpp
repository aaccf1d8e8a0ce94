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
/// Rays per slot: the daemon's minimum for a busy worker (chunk_rays_max), and enough to fill a
/// large GPU.
constexpr std::uint32_t frame_rays = 1U << 14;
constexpr std::uint32_t chunk_rays = 1U << 17;

/// An empty scene: rays pass through its root.
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

/// Times every way to answer one query, in seconds per round; all ways take turns.
class Race {
public:
    Race(const Question& question, Batch& batch) : question_(question), batch_(batch) {}

    void add(std::string name, const Route& route) { routes_.emplace_back(std::move(name), route); }
    void run(std::uint32_t rounds) {
        for (const auto& [name, route] : routes_) run_pass(route, question_, batch_);
        for (std::size_t turn = 0; turn < rounds * routes_.size(); ++turn) {
            // Each round starts with another way.
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
    /// Returns the median ratio of kernel times, round by round.
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

/// Names the number of slots in flight and the rays per slot.
std::string in_flight(std::uint32_t slots, std::uint32_t rays) {
    return std::to_string(slots) + " x " + std::to_string(rays);
}
std::string in_flight(const std::string& name, std::uint32_t slots, std::uint32_t rays) {
    return name + " in " + in_flight(slots, rays);
}

TraceFunction kernel_of(const PackVariant& variant, const Question& question) {
    return variant.trace[traversal_single][question.query][0];
}

/// Returns the best result of a way over all numbers of slots.
double best_mrays(const Race& race, const std::string& name, std::uint32_t rays) {
    double best = 0;
    for (const std::uint32_t slots : slot_counts) {
        best = std::max(best, race.mrays(in_flight(name, slots, rays), &Pass::wall_seconds));
    }
    return best;
}

nlohmann::ordered_json row_of(const Race& race, const std::string& variant,
                              const std::string& not_pinned) {
    nlohmann::ordered_json row;
    const double kernel = race.mrays(variant, &Pass::kernel_seconds);
    row["kernel_mrays"] = kernel;
    row["kernel_over_opaque"] = race.kernel_ratio(variant, "opaque");
    for (const std::uint32_t rays : {frame_rays, chunk_rays}) {
        for (const std::uint32_t slots : slot_counts) {
            const std::string way = in_flight(slots, rays);
            row["pinned_mrays"][way] =
                race.mrays(in_flight(variant, slots, rays), &Pass::wall_seconds);
            row["bus_mrays"][way] = race.mrays(in_flight("bus", slots, rays), &Pass::wall_seconds);
        }
    }
    if (!not_pinned.empty()) {
        row["not_pinned"] = not_pinned;
        return row;
    }
    // The limit is the same for both: the speed that the device allows.
    const double limit = std::min(kernel, best_mrays(race, "bus", chunk_rays));
    row["pinned_over_limit"] = best_mrays(race, variant, chunk_rays) / limit;
    row["frames_over_limit"] = best_mrays(race, variant, frame_rays) / limit;
    return row;
}

}  // namespace

void time(const OpenDevice& device, const Work& work, std::uint32_t rounds) {
    Batch batch(work.rays, work.count);
    const std::string not_pinned = batch.pin(device);
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
    const auto chunks = make_slots(slots_max, chunk_rays);

    const std::span variants(device.pack().variants, device.pack().variant_count);
    const PackVariant* const opaque = find_variant(device.pack(), "opaque");
    if (opaque == nullptr) throw std::runtime_error("the device's pack has no opaque");
    for (const Question& question : questions) {
        Race race(question, batch);
        const auto add_slots = [&](const std::string& name, const OpenDevice::Scene& through,
                                   TraceFunction kernel) {
            for (const std::uint32_t rays : {frame_rays, chunk_rays}) {
                for (const std::uint32_t slots : slot_counts) {
                    race.add(in_flight(name, slots, rays),
                             {&device, &through, kernel, std::span(chunks).first(slots), rays});
                }
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
            nlohmann::ordered_json row{
                {"query", question.name}, {"variant", name}, {"rounds", rounds}};
            row.update(row_of(race, name, not_pinned));
            work.print(std::move(row));
        }
    }
}

}  // namespace raynest::bench
