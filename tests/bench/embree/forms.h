// The ways in which Embree is asked; each is a row of its own.
#pragma once

#include "tests/bench/embree/tree.h"
#include "tests/bench/peer.h"

#include <memory>
#include <span>
#include <vector>

namespace raynest::bench {

/// embree                   rtcIntersect1, rtcOccluded1
/// embree-packet rtcIntersect16, rtcOccluded16; with AVX2 ...8, with SSE ...4: the native width
/// embree-coherent the same with the coherent flag embree-robust rtcIntersect1, rtcOccluded1 on a
/// ROBUST scene embree-filter single rays, alpha test as filter of the geometry
/// embree-filter-coherent packets with the coherent flag, the same filter embree-argument single
/// rays, alpha test as filter of the query embree-list multi-hit by a filter that rejects all
/// embree-shrink multi-hit by a filter that accepts once the list is full
std::span<const PeerForm> embree_forms();

/// Trees by how they are built: forms that differ only in how they are asked share one.
struct EmbreeTrees {
    struct Entry {
        const SceneView* view;
        TreeForm form;
        std::shared_ptr<const EmbreeTree> tree;
    };
    std::vector<Entry> entries;
};

/// Builds and commits the tree that the form needs, unless `trees` has it.
Result<std::unique_ptr<Peer>> open_embree(EmbreeTrees& trees, const PeerForm& form, Query query,
                                          const SceneView& view);

}  // namespace raynest::bench
