// Conditions that every answer must meet. The reference is checked against them, and the traversals
// against the reference.
#pragma once

#include "tests/conformance/answers.h"

#include <span>

namespace raynest::conformance {

/// Returns null, or the error in the answer to `ray`, the i-th one: an invalid ray is a flagged
/// miss; hits are finite, inside the ray's interval and in order; a miss is the canonical one.
const char* broken_promise(const Ray& ray, std::size_t i, const Question& question,
                           const Answer& answer);

/// Returns null, or how the answers to the i-th ray contradict each other, given one answer per
/// entry of `questions`. The hits of each query must be the first hits of the last one.
const char* contradiction(std::span<const Answer> answers, std::size_t i);

}  // namespace raynest::conformance
