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
    std::optional<Plan> uncounted;  ///< finds the hits; set only for count "necessary"
    [[nodiscard]] CastPlans cast() const {
        return {uncounted ? &*uncounted : nullptr, nullptr, &counted};
    }
};

/// Makes the job. `uncounted` is the plan that finds the hits; set only for count "necessary".
/// `other` are the plans of a difference, whose counts are subtracted.
[[nodiscard]] std::unique_ptr<Job> heatmap_job(const Services& services, const Caller& caller,
                                               PictureRequest asked, HeatForm form,
                                               HeatOptions options, std::vector<Column> metrics,
                                               std::optional<Plan> uncounted,
                                               std::optional<HeatPlans> other);

}  // namespace raynest::server
