// A ranking of instances, meshes and materials as the JSON document of client/EXPLAIN.md.
#pragma once

#include "engine/inspection/blame.h"
#include "server/execution/plan.h"

#include <cstdint>
#include <string>

namespace raynest::server {

/// The part of the document that says which picture it is of.
struct BlameContext {
    std::string camera;
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::uint32_t top = 0;  ///< rows of each table
    const protocol::Limits& limits;
};

[[nodiscard]] std::string blame_json(const Plan& plan, const Blame& blame,
                                     const BlameContext& context);

}  // namespace raynest::server
