// A device is trusted once it has given the CPU's answers to rays whose answers are known.
#pragma once

#include "engine/geometry/pinhole.h"
#include "engine/packs/registry.h"
#include "engine/scene/snapshot.h"

#include <functional>
#include <span>
#include <string>

namespace raynest::server::device {

/// Of a call through the device: fills in its hits and counts, or gives up with a reason.
using ProbeTrace = std::function<Result<void>(const Variant&, Query, const Snapshot&,
                                              const TraceCall&, const PinholeRays* made)>;

/// Asks the device every kind of question that it has kernels for, about a small nested scene with
/// masked leaves. Fails where it gave up, or with the first question to which its answers are not,
/// byte for byte, those of the variants' CPU target.
Result<void> probe(std::span<const Variant* const> variants, const ProbeTrace& trace);

}  // namespace raynest::server::device
