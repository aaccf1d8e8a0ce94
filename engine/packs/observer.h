// The steps of the single traversal as an observer is told them: C types, a part of the pack's ABI.
//
// A pack compiles that traversal once more per intersector, with each question told as it is
// answered (packs/observe.h). So what an observer sees is what counters count.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/intersectors/refusal.h"

#include <cstdint>

namespace raynest {

enum StepKind : std::uint32_t {
    step_node,        ///< a node: the boxes of its children were tested
    step_primitives,  ///< a block of a leaf, or a record: its primitives were tested
    step_candidate,   ///< one hit of the primitives that were tested last
    step_instance     ///< an instance was entered or not
};

enum StepOutcome : std::uint32_t {
    outcome_accepted,  ///< the instance was entered; the candidate became the best hit
    outcome_behind,    ///< the best hit is nearer, or is this very one
    outcome_refused,   ///< by the intersector
    outcome_masked,    ///< by the mask
    outcome_culled     ///< it is the back of a single-sided material, under cull=back
};

/// Lanes are bits: children of a node, triangles of a block, hits of a record.
struct Step {
    StepKind kind = step_node;
    StepOutcome outcome = outcome_accepted;  ///< for candidates and instances
    std::uint32_t object = 0;                ///< the level's, by its index in the scene
    /// Within the object: the node, the leaf block, or the record's place in tree order. Of a
    /// candidate the primitive, of an instance its index in the scene.
    std::uint32_t place = 0;
    std::uint64_t path = 0;        ///< leaf placements before the level (geometry/path.h)
    std::uint32_t tested = 0;      ///< lanes that hold a box or primitive
    std::uint32_t passed = 0;      ///< lanes that the ray enters or hits, the intersector agreeing
    std::uint32_t rejected = 0;    ///< lanes that the intersector refused
    std::uint32_t first = 0;       ///< 1: the first block or record of its leaf
    const float* nears = nullptr;  ///< for a node: where the ray enters each lane of `passed`
    float t = 0, u = 0, v = 0;     ///< for a candidate
    std::uint32_t front = 0;       ///< 1: the candidate's front faces the ray
    Refusal refusal = {};          ///< for a refused candidate, where the intersector says why
};

/// Receives the steps. Called on the thread that traces.
struct Observer {
    void* context = nullptr;
    void (*step)(void* context, const Step* step) noexcept = nullptr;
    /// After the last step of a ray; `ray` is its number in the call. An invalid ray has no steps.
    void (*end)(void* context, std::uint32_t ray, const HitRecord* hit) noexcept = nullptr;
    /// 1: candidates are told, too; they take a second look at each primitive.
    std::uint32_t candidates = 0;
};

}  // namespace raynest
