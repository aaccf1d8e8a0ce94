// An explanation as the JSON document of client/EXPLAIN.md.
#pragma once

#include "engine/inspection/explanation.h"
#include "server/execution/plan.h"

#include <array>
#include <cstdint>
#include <string>

namespace raynest::server {

/// The part of the document that says where the ray came from.
struct ExplanationContext {
    const protocol::Limits& limits;
    std::string camera;  ///< empty: the ray itself was asked for
    std::array<std::uint32_t, 2> pixel{};
    std::uint32_t width = 0;
    std::uint32_t height = 0;
};

[[nodiscard]] std::string explanation_json(const Plan& plan, const ExplanationContext& context,
                                           const Ray& ray, const Explanation& explanation);

}  // namespace raynest::server
