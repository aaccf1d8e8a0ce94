// Compares a device's answers with the CPU's before the device is used.
#pragma once

#include "engine/geometry/pinhole.h"
#include "engine/packs/registry.h"
#include "engine/scene/snapshot.h"

#include <functional>
#include <span>

namespace raynest::server::device {

/// Makes a call on the device: fills in its hits and counts, or fails with a reason. `made`, if not
/// null, generates the call's rays.
using ProbeTrace = std::function<Result<void>(const Variant&, Query, const Snapshot&,
                                              const TraceCall&, const PinholeRays* made)>;

/// Runs each query of each variant on the device, on a small nested scene with alpha-masked
/// leaves. Fails if a call fails or its answers differ in any byte from those of the CPU.
Result<void> probe(std::span<const Variant* const> variants, const ProbeTrace& trace);

}  // namespace raynest::server::device
