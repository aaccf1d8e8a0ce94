// What must be true of any answer, whoever gives it: the reference is held to this, and the
// traversals to the reference.
#pragma once

#include "tests/conformance/answers.h"

#include <span>

namespace raynest::conformance {

/// Null, or what is wrong with the answer to `ray`, the i-th one: an invalid ray is a flagged miss,
/// hits are finite, inside the ray's interval and in order, a miss is the canonical one.
const char* broken_promise(const Ray& ray, std::size_t i, const Question& question,
                           const Answer& answer);

/// Null, or how the answers to the i-th ray contradict each other; one answer per line of
/// `questions`. The hits of the others are the first ones of the last.
const char* contradiction(std::span<const Answer> answers, std::size_t i);

}  // namespace raynest::conformance
