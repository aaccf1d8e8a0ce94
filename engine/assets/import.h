// Imports files into a snapshot arena: as a pure function, and in a short-lived child process.
#pragma once

#include "engine/packs/registry.h"
#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest {

/// A file under the name by which the main file refers to it ("textures/leaf.png",
/// percent-decoded).
struct NamedBytes {
    std::string name;
    std::span<const std::byte> bytes;
};

struct ImportRequest {
    std::string source;             ///< "forest.glb", "builtin:forest?trees=100", "points.npy"
    std::vector<NamedBytes> files;  ///< files[0] is the main file; empty for built-in scenes
    std::string primitive;          ///< record type of a .npy, e.g. "sphere"
    BuildQuality build = BuildQuality::medium;
    WorldPoint origin{};             ///< subtracted from world coordinates before they are rounded
    std::vector<std::string> masks;  ///< rules "GLOB=HEX" (mask_rules.h)
};

struct ImportLimits {
    std::uint64_t bytes_max = 8ULL << 30;        ///< address space of the child
    std::uint64_t scene_bytes_max = 8ULL << 30;  ///< size of the built scene
    /// Wall time of the child, and its processor time per core.
    std::chrono::seconds time_max{120};
    std::uint64_t file_bytes_max = 1ULL << 30;
    std::uint64_t json_bytes_max = 64ULL << 20;
    std::uint32_t json_depth_max = 64;
    std::uint64_t triangles_max = 200'000'000;
    std::uint64_t instances_max = 50'000'000;
    std::uint32_t nodes_max = 4'000'000;
    std::uint32_t image_side_max = 16384;
    std::uint64_t image_bytes_max = 256ULL << 20;  ///< decoded; 4x for all images of a file
};

/// Parses, validates and describes; builds no trees. Opens no file outside `request.files`.
Result<SceneDescription> describe(const ImportRequest& request, const ImportLimits& limits,
                                  const Registry& registry);

/// Runs describe() and build_arena() in this process.
Result<BuiltArena> import_arena(const ImportRequest& request, const ImportLimits& limits,
                                const Registry& registry);

/// Runs import_arena() and Snapshot::open(). For embedders that trust their files, and for tests.
Result<std::shared_ptr<const Snapshot>> import_here(const ImportRequest& request,
                                                    const ImportLimits& limits,
                                                    const Registry& registry);

/// Tells whether an import goes on. It gets the bytes that the child holds of the machine's memory,
/// besides its copy of the files; at the end also those that the caller needs to read its result.
using StillWanted = std::function<bool(std::uint64_t child_bytes)>;

/// Imports in a child process with limits on memory and time: a crash, a time-out or a limit
/// becomes an Error and does not harm the caller. `child` is a command line that calls
/// import_child_main, e.g. {"/usr/bin/raynestd", "--import-child"}. The calling thread polls
/// `wanted` every millisecond: once it returns false, the child is killed and the result is an
/// error. Blocking; thread-safe.
Result<std::shared_ptr<const Snapshot>> import_in_child(
    const ImportRequest& request, const ImportLimits& limits, std::span<const std::string> child,
    const StillWanted& wanted = [](std::uint64_t) { return true; });

/// The child's main function: reads the request from fd 3, writes the arena or the error to fd 4.
/// Returns the process's exit code.
int import_child_main(const Registry& registry);

/// Describes builtin:forest[?trees=..&leaves=..&levels=1..4&seed=..], builtin:flake[?depth=..] or
/// builtin:terrain[?size=..&seed=..]. A scene_invalid error names the known keys.
Result<SceneDescription> describe_builtin(std::string_view source);

}  // namespace raynest
