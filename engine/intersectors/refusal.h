// Why an intersector refused a candidate, in its own words.
//
//     Refusal refusal(const RayView& ray, const Surface& surface) const;
//
// is optional. `raynest explain` calls it for candidates that the intersector has refused; queries
// never do.
#pragma once

namespace raynest {

/// "alpha 0.31 below 0.5", or `what` alone where `relation` is null. All texts have static storage.
struct Refusal {
    const char* what = nullptr;  ///< null: no words
    float value = 0;
    const char* relation = nullptr;
    float limit = 0;
};

}  // namespace raynest
