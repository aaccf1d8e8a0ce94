// One side of a measurement: a variant of ours or a form of a peer, with what it answered.
#pragma once

#include "engine/packs/kernel_selector.h"
#include "tests/bench/answers.h"
#include "tests/bench/peer.h"
#include "tests/bench/race.h"
#include "tests/bench/workload.h"

#include <memory>
#include <span>
#include <string>

namespace raynest::bench {

/// The columns of a row that name a side. Peers have a name and a width only.
struct Label {
    std::string name;  ///< as opponent: "embree-packet", "own", "own-over"
    std::string traversal = {};
    std::string intersector = {};
    std::string counters = {};  ///< none | total | level
    std::string target = {};
    unsigned threads = 1;
    std::uint32_t width = 1;  ///< rays of a call of a peer
};

struct Side {
    Label label;
    bool masks = false;   ///< tests alpha; only sides that ask the same are compared
    bool over = false;    ///< traces the other form of the scene
    double adjusted = 1;  ///< how much faster this side would be with its asserts off
    std::unique_ptr<Answers> answers;
    std::unique_ptr<const Peer> peer;  ///< null for ours
    TracePart trace;
};

/// Returns the counters that a word of --counters means.
[[nodiscard]] CounterMode counter_mode(const std::string& word);

/// Every call chooses a traversal where the selector is open, as a worker does for every chunk.
/// Counters are those of label.counters; each chunk overwrites those of the last one.
Side make_own_side(Label label, const Workload& workload, const KernelSelector& selector,
                   std::span<const Ray> rays, Query query, std::uint32_t hits_max);
Result<Side> make_peer_side(PeerLibrary& library, const PeerForm& form, const Workload& workload,
                            std::span<const Ray> rays, Query query, std::uint32_t hits_max);

/// First pass: warms caches and pages, and leaves the answers, translated to our ids.
void answer(Side& side, std::uint32_t ray_count);

}  // namespace raynest::bench
