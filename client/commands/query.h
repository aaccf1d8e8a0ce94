// The options of `raynest query`, which the Python package carries out in part.
#pragma once

#include "client/requests/request_options.h"

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace raynest::client {

struct QueryOptions {
    JobOptions job;
    std::vector<WorldRay> rays;
    std::vector<std::string> generate;  ///< a kind and key=value (generator.h), or empty
    std::string step_error;             ///< for a sweep: a setting of its generator
    std::string rays_file, masks_file, kind, reduce, output;
    std::optional<WorldPoint> from;  ///< common origin of the file's rays
    std::uint32_t max_hits = 0;      ///< 0: the kind's default
    std::vector<std::string> fields;
    PartOption part;
    /// Arguments of raynest.returns.measure() (by_python.h), and their values as JSON
    std::vector<std::pair<std::string, std::string>> measure;
    std::string prefer;      ///< nearest | strongest
    std::string times_file;  ///< for rays that are sent
    double time_step = 0;    ///< seconds; 0: each ray has its own time
};

}  // namespace raynest::client
