// The traversal of one ray as a tree, for people.
//
//   kernel with an observer ──Step──► ExplanationRecorder ──► Explanation
#pragma once

#include "engine/geometry/hit.h"
#include "engine/inspection/descent.h"
#include "engine/inspection/names.h"
#include "engine/packs/observer.h"
#include "engine/scene/snapshot.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <vector>

namespace raynest {

/// The kinds of entries of an explanation's tree.
enum class EntryKind : std::uint8_t { instance, node, leaf, candidate };
inline constexpr std::size_t entry_kinds = 4;

/// Entries come in the order of the traversal, a parent before its children. Boxes are those of the
/// world less the scene's origin.
struct ExplainedEntry {
    EntryKind kind = EntryKind::node;
    StepOutcome outcome = outcome_accepted;  ///< for instances and candidates
    std::uint32_t parent = no_id;  ///< its index among the entries; no_id: the root's tree
    std::uint32_t level = 0;       ///< level of its tree; for an instance, of the tree it opens
    std::uint32_t object = no_id;  ///< whose tree that is
    std::uint32_t place = 0;       ///< node, first block or record, primitive
    PlacementRange placements;     ///< for an instance: what it places
    Box box;                       ///< not of candidates
    float near = 0;                ///< where the ray enters the box
    std::uint32_t tested = 0;      ///< boxes or primitives
    std::uint32_t passed = 0;      ///< those entered or hit
    std::uint32_t refused = 0;     ///< those refused by the intersector
    std::uint32_t behind = 0;      ///< for a node: entered boxes behind the best hit, unvisited
    float t = 0, u = 0, v = 0;     ///< for a candidate
    bool front = false;
    Refusal refusal = {};
};

struct Explanation {
    HitRecord hit;
    Counters totals;
    std::vector<Counters> levels;  ///< totals by level; 0 is the root's tree
    std::vector<ExplainedEntry> entries;
    std::uint32_t hit_entry = no_id;                    ///< the candidate that is the hit
    std::array<std::uint64_t, entry_kinds> left_out{};  ///< entries beyond the limit, by kind
};

/// Records one ray. An Observer for one call of a kernel with one ray.
class ExplanationRecorder {
public:
    /// Keeps the first `entries_max` entries and counts the others.
    ExplanationRecorder(const Snapshot& scene, std::size_t entries_max);
    ExplanationRecorder(const ExplanationRecorder&) = delete;

    [[nodiscard]] const Observer& observer() const { return observer_; }
    /// After the call. Throws std::bad_alloc if memory ran out during it.
    [[nodiscard]] Explanation take();

private:
    /// A child that a node's test has entered, until it is visited.
    struct Entered {
        std::uint32_t parent;
        float near;
        Box box;  ///< in the world
    };
    struct Level {
        std::uint32_t object = 0;
        std::uint32_t instance = no_id;
        std::uint32_t entry = no_id;  ///< that of the instance
        Transform to_world;
        Box bounds;  ///< in the world
        float near = 0;
        bool missed = true;  ///< the instance counts as one without a hit
        std::unordered_map<std::uint32_t, Entered> entered = {};  ///< by key_of() of the child
    };

    void add(const Step& step);
    void add_node(Level& level, const Step& step);
    void add_primitives(Level& level, const Step& step);
    void add_candidate(const Step& step);
    void add_instance(const Step& step);
    void count(const Step& step);
    /// Something is hit: the instances around it are not without a hit.
    void leave_missed();
    /// Places an entry in the tree: its parent, box and where the ray enters it. `key` is no_id for
    /// what is no child of a node. Returns its index, or no_id where it is left out.
    std::uint32_t append(Level& level, std::uint32_t key, ExplainedEntry entry);
    [[nodiscard]] std::uint32_t depth() const {
        return static_cast<std::uint32_t>(descent_.levels().size() - 1);
    }

    const Snapshot& scene_;
    const std::size_t entries_max_;
    Observer observer_;
    Descent<Level> descent_;
    Explanation told_;
    std::uint32_t leaf_ = no_id;  ///< the entry of the leaf that is tested
    bool failed_ = false;         ///< memory ran out: kernels take no exceptions
};

}  // namespace raynest
