// How a job went, as JSON and in words.
#pragma once

#include "client/ground/json.h"
#include "client/requests/job.h"
#include "client/requests/picture.h"

#include <string>

namespace raynest::client {

/// Returns the JSON keys that all jobs have.
[[nodiscard]] Json outcome_json(const Outcome& outcome);
/// "518,400 rays in 0.412 s (1.26 Mrays/s), alpha_mask on v3, stream, forest epoch 1".
[[nodiscard]] std::string outcome_text(const Outcome& outcome);
/// Prints the daemon's notes on stderr.
void print_notes(const Outcome& outcome);

/// Returns the JSON keys that all pictures have.
[[nodiscard]] Json picture_json(const std::string& file, const ReceivedFile& picture);
/// Returns "forest.png: 960x540, " and outcome_text().
[[nodiscard]] std::string picture_text(const std::string& file, const ReceivedFile& picture);

}  // namespace raynest::client
