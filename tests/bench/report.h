// One row per measurement: a JSON object, or a line of a table.
#pragma once

#include "tests/bench/answers.h"
#include "tests/bench/options.h"
#include "tests/bench/race.h"
#include "tests/bench/side.h"

#include <nlohmann/json_fwd.hpp>

#include <span>
#include <string>

namespace raynest::bench {

/// The columns that all rows of a set of rays share.
struct Setting {
    std::string scene;
    std::string scene_hash;
    std::string rays;
    std::string kind;
    std::uint32_t ray_count = 0;
    std::string peer_about;  ///< PeerLibrary::about()
};

/// A side's laps and, where it has one, its opponent's.
struct Outcome {
    const Side& ours;
    std::span<const Lap> laps;
    double crowded_from;  ///< as RaceLaps has it
    const Side* opponent = nullptr;
    std::span<const Lap> opponent_laps = {};
    Differences differences = {};      ///< to the opponent
    std::uint64_t mismatches_max = 0;  ///< what edges explain
    Differences ref_differences = {};  ///< to --ref
};

void print_header(const Options& options);
void print_row(const Options& options, const Setting& setting, const Outcome& outcome);
/// A row of another shape (--build): with --json the object, else its members in order.
void print_object(const Options& options, nlohmann::ordered_json row);

}  // namespace raynest::bench
