// Procedural scenes: one function each, and the keys that a user may set.
//
// A new scene is one file and one line in builtin.cpp's table.
#pragma once

#include "engine/result.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <map>
#include <string>
#include <string_view>

namespace raynest {

/// A whole-number key of a built-in scene.
struct BuiltinKey {
    std::string_view name;
    std::uint64_t initial;
    std::uint64_t minimum;
    std::uint64_t maximum;
};

/// Every key of the scene, at its initial value where the user gave none.
using BuiltinValues = std::map<std::string, std::uint64_t, std::less<>>;

/// Ground, and trees of leaf cards in nested instances. Same values, same bytes.
Result<SceneDescription> describe_forest(const BuiltinValues& values);
/// A height field of size x size cells without instances.
Result<SceneDescription> describe_terrain(const BuiltinValues& values);
/// Spheres on spheres: records of type "sphere", one nesting level per generation.
Result<SceneDescription> describe_flake(const BuiltinValues& values);

/// Merges instances into their parents from the bottom until the root has at most `levels` levels
/// of objects below and including it. limit_exceeded when more than `triangles_max` would be
/// written.
Result<void> flatten_levels(SceneDescription& scene, std::uint32_t levels,
                            std::uint64_t triangles_max);

}  // namespace raynest
