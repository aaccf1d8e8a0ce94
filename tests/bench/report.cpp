#include "tests/bench/report.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstdio>
#include <iostream>

namespace raynest::bench {
namespace {

/// Million rays per second of CPU time.
double rate(const Setting& setting, double seconds) {
    return 1e-6 * setting.ray_count / seconds;
}

double best_cpu(std::span<const Lap> laps) {
    return std::min_element(
               laps.begin(), laps.end(),
               [](const Lap& a, const Lap& b) { return a.cpu_seconds < b.cpu_seconds; })
        ->cpu_seconds;
}

double median_wall(std::span<const Lap> laps) {
    std::vector<double> seconds;
    for (const Lap& lap : laps) seconds.push_back(lap.wall_seconds);
    return median(std::move(seconds));
}

/// The opponent's time over ours, round by round.
std::vector<double> ratios_of(const Outcome& outcome) {
    std::vector<double> ratios;
    for (std::size_t round = 0; round < outcome.laps.size(); ++round) {
        ratios.push_back(outcome.opponent_laps[round].cpu_seconds /
                         outcome.laps[round].cpu_seconds);
    }
    return ratios;
}

nlohmann::ordered_json row_of(const Options& options, const Setting& setting,
                              const Outcome& outcome) {
    const Label& label = outcome.ours.label;
    const double ours = uncrowded_seconds(outcome.laps, outcome.crowded_from);
    nlohmann::ordered_json row{{"scene", setting.scene},
                               {"rays", setting.rays},
                               {"kind", setting.kind},
                               {"traversal", label.traversal},
                               {"intersector", label.intersector},
                               {"counters", label.counters},
                               {"target", label.target},
                               {"threads", label.threads},
                               {"mrays", rate(setting, ours)},
                               {"mrays_best", rate(setting, best_cpu(outcome.laps))},
                               {"mrays_wall", rate(setting, median_wall(outcome.laps))},
                               {"peer", ""},
                               {"peer_mrays", 0.0},
                               {"ratio", 0.0},
                               {"mismatches", outcome.differences.mismatches}};
    if (outcome.opponent != nullptr) {
        const std::vector<double> ratios = ratios_of(outcome);
        const auto [low, high] = std::minmax_element(ratios.begin(), ratios.end());
        const double theirs = uncrowded_seconds(outcome.opponent_laps, outcome.crowded_from);
        const double ratio = theirs / ours;
        const bool own = outcome.opponent->peer == nullptr;
        row["peer"] = outcome.opponent->label.name;
        row["peer_mrays"] = rate(setting, theirs);
        row["peer_mrays_best"] = rate(setting, best_cpu(outcome.opponent_laps));
        row["peer_width"] = outcome.opponent->label.width;
        row["peer_about"] = own ? "" : setting.peer_about;
        row["ratio"] = ratio;
        row["ratio_adjusted"] = ratio / outcome.opponent->adjusted;
        row["ratio_best"] = best_cpu(outcome.opponent_laps) / best_cpu(outcome.laps);
        row["ratio_all"] = median(ratios);
        row["ratio_all_adjusted"] = median(ratios) / outcome.opponent->adjusted;
        row["crowded_from"] = outcome.crowded_from;
        row["uncrowded"] = std::min(uncrowded_share(outcome.laps, outcome.crowded_from),
                                    uncrowded_share(outcome.opponent_laps, outcome.crowded_from));
        row["ratio_low"] = *low;
        row["ratio_high"] = *high;
        row["mismatches_max"] = outcome.mismatches_max;
        row["ties"] = outcome.differences.ties;
        row["mask_borders"] = outcome.differences.mask_borders;
    }
    if (!options.ref.empty()) {
        row["ref_mismatches"] = outcome.ref_differences.mismatches;
        row["ref_ties"] = outcome.ref_differences.ties;
    }
    row["scene_hash"] = setting.scene_hash;
    row["count"] = setting.ray_count;
    row["rounds"] = outcome.laps.size();
    row["command"] = options.command;
    return row;
}

}  // namespace

void print_header(const Options& options) {
    if (options.json || options.build) return;
    std::printf("%-12s %-8s %-8s %-9s %-12s %-6s %3s %9s  %-16s %9s %6s %6s %10s %6s\n", "scene",
                "rays", "kind", "traversal", "intersector", "target", "thr", "Mrays/s", "peer",
                "Mrays/s", "ratio", "adj.", "mismatches", "ties");
}

void print_row(const Options& options, const Setting& setting, const Outcome& outcome) {
    const nlohmann::ordered_json row = row_of(options, setting, outcome);
    if (options.json) {
        std::cout << row.dump() << std::endl;
        return;
    }
    const Label& label = outcome.ours.label;
    const std::string traversal =
        label.traversal + (label.counters == "none" ? "" : "+" + label.counters);
    std::printf("%-12s %-8s %-8s %-9s %-12s %-6s %3u %9.2f", setting.scene.c_str(),
                setting.rays.c_str(), setting.kind.c_str(), traversal.c_str(),
                label.intersector.c_str(), label.target.c_str(), label.threads,
                row["mrays"].get<double>());
    if (outcome.opponent != nullptr) {
        std::printf("  %-16s %9.2f %6.2f %6.2f %10llu %6llu", outcome.opponent->label.name.c_str(),
                    row["peer_mrays"].get<double>(), row["ratio"].get<double>(),
                    row["ratio_adjusted"].get<double>(),
                    static_cast<unsigned long long>(outcome.differences.mismatches),
                    static_cast<unsigned long long>(outcome.differences.ties));
    }
    std::printf("\n");
    std::fflush(stdout);
}

void print_object(const Options& options, nlohmann::ordered_json row) {
    row["command"] = options.command;
    if (options.json) {
        std::cout << row.dump() << std::endl;
        return;
    }
    row.erase("command");
    for (const auto& [key, value] : row.items()) std::cout << key << " " << value << "  ";
    std::cout << std::endl;
}

}  // namespace raynest::bench
