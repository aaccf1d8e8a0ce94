// The scenes that the daemon holds: names are aliases of content.
//
// A scene is immutable; jobs keep the one they started with. Replacing a name publishes a new
// epoch, unloading drops one principal's reference, and memory returns with the last holder.
#pragma once

#include "engine/scene/snapshot.h"
#include "protocol/limits.h"
#include "server/errors.h"
#include "server/store/budget.h"

#include <cstdint>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

/// A snapshot and the memory it is charged for. Shared by names, requests and running jobs.
struct HeldScene {
    std::shared_ptr<const Snapshot> snapshot;
    Budget::Lease lease;
};

/// What a name means at one moment.
struct NamedScene {
    std::string name;
    std::uint64_t epoch = 0;  ///< 1 for the first content of a name
    std::shared_ptr<const HeldScene> held;
    [[nodiscard]] const Snapshot& snapshot() const { return *held->snapshot; }
};

/// Not thread-safe: belongs to the io thread.
class SceneStore {
public:
    /// The quotas are principal_scenes_max and principal_scene_bytes_max.
    explicit SceneStore(Budget& budget, const protocol::Limits& limits = {})
        : budget_(budget),
          limits_(limits) {}

    /// May `principal` hold a scene of `bytes` under this name, beside its others? QUOTA if not.
    [[nodiscard]] Reply<void> check_quota(const std::string& name, const std::string& principal,
                                          std::uint64_t bytes) const;

    /// Gives `snapshot` a name and `principal` a reference to it. Equal content under the same name
    /// is no change; other content is NAME_TAKEN unless `replace`, and NOT_ALLOWED where others
    /// hold the name. QUOTA when it would be too much for the principal, RESOURCE_EXHAUSTED when
    /// the budget cannot hold it. Equal content under two names is held once.
    Reply<NamedScene> publish(const std::string& name, std::shared_ptr<const Snapshot> snapshot,
                              bool replace, const std::string& principal);

    /// Is this content held already, under any name or by a running job?
    [[nodiscard]] bool holds(const std::string& hash) const;

    /// `epoch` 0 takes the current one; any other must be it. SCENE_UNKNOWN says what to type.
    [[nodiscard]] Reply<NamedScene> find(std::string_view name, std::uint64_t epoch) const;

    /// Drops the principal's reference; true when that was the last one and the name is free.
    Reply<bool> unload(std::string_view name, const std::string& principal);

    /// In order of names.
    [[nodiscard]] std::vector<NamedScene> list() const;

private:
    struct Entry {
        NamedScene scene;
        std::set<std::string> principals;
    };
    Reply<std::shared_ptr<const HeldScene>> hold(std::shared_ptr<const Snapshot> snapshot);

    Budget& budget_;
    const protocol::Limits limits_;
    std::map<std::string, Entry, std::less<>> entries_;
    std::map<std::string, std::weak_ptr<const HeldScene>> by_hash_;
};

}  // namespace raynest::server
