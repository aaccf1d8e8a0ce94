// The scene of a name, as its readers hold it.
#pragma once

#include "engine/scene/snapshot.h"
#include "server/ground/budget.h"

#include <cstdint>
#include <map>
#include <memory>
#include <string>

namespace raynest::server {

class LateVelocities;
class PartDigests;

/// A snapshot and its memory reservation. Shared by names, requests and running jobs.
struct HeldScene {
    std::shared_ptr<const Snapshot> snapshot;
    mutable Budget::Lease lease;  ///< charged to one of those who hold the scene; io thread only
    /// For Snapshot::shared(), which all that share it have together.
    std::shared_ptr<const Budget::Lease> shared_lease = {};
    /// Null unless the scene is at a moment of an animation.
    std::shared_ptr<const LateVelocities> velocities = {};
    /// NamedScene::reading of each principal whose requests read the scene. Io thread only.
    mutable std::map<std::string, std::weak_ptr<const void>> readers = {};
    /// Made by SceneStore::visible_scenes(); io thread only, what it refers to is thread-safe.
    mutable std::shared_ptr<PartDigests> part_digests = {};
    /// True while neither a name nor a connection refers to the scene: a reader is charged for it.
    mutable bool is_left_to_readers = false;
    /// True if those who hold the scene, or see who does, have changed: the charges are to be settled.
    mutable bool is_unsettled = false;
    /// Bytes that owners have of it and another is charged for. Io thread only.
    mutable Budget::Unpaid unpaid = {};

    /// Returns a principal whose requests read the scene and for which `is_meant` is true; null: none.
    template <class IsMeant>
    [[nodiscard]] const std::string* reader(IsMeant is_meant) const {
        for (const auto& [principal, reading] : readers)
            if (!reading.expired() && is_meant(principal)) return &principal;
        return nullptr;
    }
};

/// Known of a scene also while it is on the disk alone.
struct SceneFacts {
    std::string digest;  ///< its content's digest
    /// Snapshot::arena_id(), or what stands for it while the scene is on the disk: scenes of equal
    /// content share their memory only where their trees are the same bytes, too.
    std::string arena;
    std::uint64_t bytes = 0;
    std::uint64_t instanced_triangles = 0;
};
[[nodiscard]] inline SceneFacts facts_of(const Snapshot& snapshot) {
    return {snapshot.digest(), snapshot.arena_id(), snapshot.bytes().size(),
            snapshot.statistics().instanced_triangles};
}

/// The scene of a name at one epoch.
struct NamedScene {
    std::string name;         ///< as its caller finds it: "car", or "OWNER/car" of another owner
    std::uint64_t epoch = 0;  ///< 1 for the first content of a name
    /// The time of the load that published it. Equal content is held once, and the time that another's load
    /// took would tell that it is there.
    double build_seconds = 0;
    bool kept = false;                         ///< as it is, it outlives the daemon
    std::string last_edit = {};                ///< what the last edit changed; empty since a load
    std::shared_ptr<const HeldScene> held;     ///< null in lists alone, for a scene on the disk
    std::shared_ptr<const void> reading = {};  ///< kept by a request as long as it reads the scene
    [[nodiscard]] const Snapshot& snapshot() const { return *held->snapshot; }
    /// Bytes of a scene that only requests refer to any more, if they are charged to this principal.
    [[nodiscard]] std::uint64_t left_bytes(const std::string& principal) const {
        return held && held->is_left_to_readers && held->lease.principal() == principal
                   ? held->lease.bytes()
                   : 0;
    }
};

}  // namespace raynest::server
