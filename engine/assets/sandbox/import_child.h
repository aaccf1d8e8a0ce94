// Imports files in a short-lived child process.
#pragma once

#include "engine/assets/import.h"
#include "engine/assets/input/import_request.h"
#include "engine/packs/registry.h"
#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>

namespace raynest {

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

/// The child's main function: reads the request from fd 3, writes the arena or the error to fd 4. Its
/// built-in scenes are those of `builtin`. Returns the process's exit code.
int import_child_main(const Registry& registry, DescribeBuiltin builtin = nullptr);

}  // namespace raynest
