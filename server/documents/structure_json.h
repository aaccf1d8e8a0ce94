// Objects, placements and tree boxes of a scene as the JSON documents of client/EXPLAIN.md.
#pragma once

#include "protocol/limits.h"
#include "server/ground/errors.h"
#include "server/ground/stop.h"
#include "server/store/named_scene.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace raynest::server {

/// The checked request.
struct StructureRequest {
    enum class Kind : std::uint8_t { objects, placements, boxes, paths, tree } kind = Kind::objects;
    std::uint64_t first = 0;
    std::size_t count = 0;
    std::uint32_t level = 0;
    std::uint32_t depth_min = 0;
    std::uint32_t depth_max = 0;
    bool one = false;
    std::vector<std::uint64_t> paths = {};
};

/// Fails for a path that the scene has not.
[[nodiscard]] Reply<std::string> structure_json(const NamedScene& scene,
                                                const StructureRequest& request,
                                                const protocol::Limits& limits, const Stop& stop);

}  // namespace raynest::server
