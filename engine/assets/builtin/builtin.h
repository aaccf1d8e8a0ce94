// Procedural scenes: one function per scene, and the keys that a user may set.
//
// A new scene is one file and one line in the table of builtin.cpp.
#pragma once

#include "engine/result.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <map>
#include <string>
#include <string_view>

namespace raynest {

/// A whole-number parameter of a built-in scene.
struct BuiltinKey {
    std::string_view name;
    std::uint64_t initial;
    std::uint64_t minimum;
    std::uint64_t maximum;
};

/// The value of every key of a scene: the user's or the default.
using BuiltinValues = std::map<std::string, std::uint64_t, std::less<>>;

/// Describes builtin:forest[?trees=..&leaves=..&levels=1..4&wind=0..3&seconds=..&seed=..],
/// builtin:flake[?depth=..], builtin:terrain[?size=..&seed=..] or
/// builtin:street[?cars=..&length=..&seconds=..&seed=..]. A scene_invalid error names the known
/// keys.
Result<SceneDescription> describe_builtin(std::string_view source);

/// Describes ground, and trees of leaf cards in nested instances. Equal values give equal bytes.
/// With `wind` all plants sway for `seconds`; then the trees of a stand are instances of the root.
/// scene_invalid for wind in one level, or over more than 20,000 trees.
Result<SceneDescription> describe_forest(const BuiltinValues& values);
/// Describes a height field of size x size cells without instances.
Result<SceneDescription> describe_terrain(const BuiltinValues& values);
/// Describes spheres on spheres: records of type "sphere", one nesting level per generation.
Result<SceneDescription> describe_flake(const BuiltinValues& values);
/// Describes houses, trees, lamps and cars along a street; a car is an instance with four more for
/// its wheels.
Result<SceneDescription> describe_street(const BuiltinValues& values);

/// Merges instances into their parents, from the bottom up, until the root has at most `levels`
/// levels of objects, itself included. limit_exceeded if this would write more than `triangles_max`
/// triangles.
Result<void> flatten_levels(SceneDescription& scene, std::uint32_t levels,
                            std::uint64_t triangles_max);

}  // namespace raynest
