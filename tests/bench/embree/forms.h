// The ways in which Embree is asked; each is a row of its own.
#pragma once

#include "tests/bench/embree/tree.h"
#include "tests/bench/peer.h"

#include <memory>
#include <span>

namespace raynest::bench {

/// embree            rtcIntersect1, rtcOccluded1
/// embree-packet     rtcIntersect16, rtcOccluded16
/// embree-coherent   the same with the coherent flag
/// embree-robust     rtcIntersect1, rtcOccluded1 on a ROBUST scene
/// embree-filter     single rays, alpha test as filter of the geometry
/// embree-argument   single rays, alpha test as filter of the query
/// embree-list       multi-hit by a filter that rejects all
/// embree-shrink     multi-hit by a filter that accepts once the list is full
std::span<const PeerForm> embree_forms();

/// Builds and commits the scene that the form needs.
Result<std::unique_ptr<Peer>> open_embree(const PeerForm& form, Query query, const SceneView& view);

}  // namespace raynest::bench
