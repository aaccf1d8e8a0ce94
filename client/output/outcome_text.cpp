#include "client/output/outcome_text.h"

#include "client/ground/text.h"

#include <array>
#include <cstdio>
#include <iostream>

namespace raynest::client {

Json outcome_json(const Outcome& outcome) {
    Json json{{"scene", outcome.scene},
              {"hash", outcome.hash},
              {"epoch", outcome.epoch},
              {"intersector", outcome.intersector},
              {"target", outcome.target},
              {"traversal", outcome.traversal},
              {"worker", outcome.worker},
              {"worker_reason", outcome.worker_reason},
              {"camera", outcome.camera},
              {"notes", outcome.notes},
              {"origin", outcome.origin},
              {"rays", outcome.rays},
              {"hits", outcome.hits},
              {"misses", outcome.misses},
              {"truncated", outcome.truncated},
              {"invalid", outcome.invalid},
              {"rows", outcome.rows.value_or(0)},
              {"seconds", outcome.seconds},
              {"queued_seconds", outcome.queued_seconds}};
    if (!outcome.note_of_all.empty()) json["note_of_all"] = outcome.note_of_all;
    if (outcome.invalid != 0) json["first_invalid"] = outcome.first_invalid;
    // A picture that its deadline ended may have pixels without one.
    if (outcome.samples != 0 || outcome.incomplete) {
        json["samples"] = outcome.samples;
        json["noise"] = outcome.noise;
        json["dropped"] = outcome.dropped;
        json["incomplete"] = outcome.incomplete;
    }
    return json;
}

std::string outcome_text(const Outcome& outcome) {
    std::array<char, 48> rate{};
    if (outcome.seconds > 0)
        std::snprintf(rate.data(), rate.size(), " (%.2f Mrays/s)",
                      static_cast<double>(outcome.rays) / outcome.seconds / 1e6);
    return grouped(outcome.rays) + (outcome.rays == 1 ? " ray in " : " rays in ") +
           seconds_text(outcome.seconds) + rate.data() + ", " + outcome.intersector + " on " +
           outcome.target + ", " + outcome.traversal + ", " + outcome.scene + " epoch " +
           std::to_string(outcome.epoch);
}

void print_notes(const Outcome& outcome) {
    for (const std::string& note : outcome.notes) print_note(note);
    if (outcome.invalid == 1)
        std::cerr << "raynest: ray " << outcome.first_invalid
                  << " is not valid and counts as a miss";
    if (outcome.invalid > 1)
        std::cerr << "raynest: " << grouped(outcome.invalid) << " of " << grouped(outcome.rays)
                  << " rays are not valid and count as misses, the first is ray "
                  << outcome.first_invalid;
    if (outcome.invalid != 0)
        std::cerr << ": something in it is not finite, its direction is zero, or tmin is negative "
                     "or beyond tmax\n";
}

Json picture_json(const std::string& file, const ReceivedFile& picture) {
    Json json = outcome_json(picture.outcome);
    json["file"] = file;
    json["width"] = picture.width;
    json["height"] = picture.height;
    return json;
}

std::string picture_text(const std::string& file, const ReceivedFile& picture) {
    return file + ": " + std::to_string(picture.width) + "x" + std::to_string(picture.height) +
           ", " + outcome_text(picture.outcome);
}

}  // namespace raynest::client
