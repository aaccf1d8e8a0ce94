// A map of what each pixel's ray costs, or of the difference to another scene.
#pragma once

#include "engine/integrators/picture.h"
#include "server/documents/selection_text.h"
#include "server/jobs/picture_job.h"

#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

/// The answer's form: a file, or a document with the statistics of every metric, and perhaps the
/// file in it.
struct HeatForm {
    std::string file;  ///< png | exr | raw; empty: no file
    bool document = false;
    SelectionText selected;  ///< what the file or document says is hidden
    /// Counts every metric, in total and of each level.
    [[nodiscard]] bool all_metrics() const { return document || file == "exr"; }
};

/// Plans of one scene and its options.
struct HeatPlans {
    Plan counted;
    std::optional<Plan> uncounted = {};  ///< finds the hits; set only for count "necessary"
    std::optional<Plan> timed = {};      ///< set only where time is measured
    [[nodiscard]] CastPlans cast() const { return cast(counted); }
    [[nodiscard]] CastPlans cast(const Plan& counting) const {
        return {.closest = uncounted ? &*uncounted : nullptr,
                .counted = &counting,
                .timed = timed ? &*timed : nullptr};
    }
};

/// Makes the job. `asked.plan` counts; the other plans of the scene are in `plans`. `other` are the
/// plans of a difference, whose counts are subtracted. Metrics of measures.def are the last ones.
[[nodiscard]] std::unique_ptr<Job> heatmap_job(const Services& services, const Caller& caller,
                                               PictureRequest asked, HeatForm form,
                                               HeatOptions options, std::vector<HeatMetric> metrics,
                                               HeatPlans plans, std::optional<HeatPlans> other);

}  // namespace raynest::server
