// The scenes that the daemon holds, by name.
//
// A scene is immutable; jobs keep the one they started with. A scene stays while it has references:
// one for each principal that loaded it (unless as temporary), and one for each open connection
// that loaded or opened it. Unloading drops the references of the caller's principal and
// connection. When no principal is left, the name is free for others; connections that still hold
// the scene can go on using the name. Replacing a name's content publishes a new epoch for all
// holders. The last reference frees the memory.
#pragma once

#include "engine/scene/snapshot.h"
#include "protocol/limits.h"
#include "server/errors.h"
#include "server/store/budget.h"

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

/// A snapshot and its memory reservation. Shared by names, requests and running jobs.
struct HeldScene {
    std::shared_ptr<const Snapshot> snapshot;
    Budget::Lease lease;
};

/// The scene of a name at one epoch.
struct NamedScene {
    std::string name;
    std::uint64_t epoch = 0;  ///< 1 for the first content of a name
    std::shared_ptr<const HeldScene> held;
    [[nodiscard]] const Snapshot& snapshot() const { return *held->snapshot; }
};

/// An open connection: its principal, and its number among all connections.
struct ConnectionId {
    std::string principal;
    std::uint64_t connection = 0;  ///< from SceneStore::connect(); never reused
};

/// How a load publishes its scene.
struct Publication {
    bool replace = false;    ///< true: replace different content of that name
    bool temporary = false;  ///< true: drop the scene when its last connection closes
};

/// The table of scenes. Io thread only.
class SceneStore {
public:
    using Clock = std::chrono::steady_clock;
    using Now = std::function<Clock::time_point()>;

    /// The quotas are principal_scenes_max and principal_scene_bytes_max.
    explicit SceneStore(Budget& budget, const protocol::Limits& limits = {}, Now now = Clock::now)
        : budget_(budget),
          limits_(limits),
          now_(std::move(now)) {}

    /// Returns the number of a new connection.
    [[nodiscard]] std::uint64_t connect() { return ++last_connection_; }
    /// Drops the references of a connection that has ended. Idempotent; allocates no memory.
    void disconnect(const ConnectionId& caller) noexcept;

    /// Checks that the caller's principal may hold a scene of `bytes` under this name, besides its
    /// others. Otherwise fails with QUOTA and proposes what to unload.
    [[nodiscard]] Reply<void> check_quota(std::string_view name, const ConnectionId& caller,
                                          std::uint64_t bytes) const;

    /// Publishes a snapshot under a name, and gives the caller's principal and connection a
    /// reference to it. Equal content under the same name keeps its epoch. Different content fails
    /// with NAME_TAKEN unless `how.replace`, and with NOT_ALLOWED if other principals use the name
    /// too. Fails with QUOTA beyond the principal's quota, and with RESOURCE_EXHAUSTED if the
    /// budget has no room. Equal content under two names is stored once.
    Reply<NamedScene> publish(const std::string& name, std::shared_ptr<const Snapshot> snapshot,
                              Publication how, const ConnectionId& caller);

    /// True if this content is stored under any name or used by a running job.
    [[nodiscard]] bool holds(const std::string& hash) const;

    /// Returns the scene of that name which the caller holds, or else the listed one. `epoch` must
    /// be 0 or the current epoch. Fails with SCENE_UNKNOWN and a remedy.
    [[nodiscard]] Reply<NamedScene> find(std::string_view name, std::uint64_t epoch,
                                         const ConnectionId& caller) const;

    /// Finds a scene as find() does, and gives the caller's connection a reference to it. Fails
    /// with QUOTA as publish() does.
    Reply<NamedScene> open(std::string_view name, const ConnectionId& caller);

    struct Unloaded {
        std::string name;
        std::vector<std::string> holders;  ///< remaining holders, as unload() returns them
    };
    /// Drops the references of the caller's principal and connection; only that of the connection
    /// if it loaded the scene as temporary. Returns the remaining holders, one text per principal:
    /// "uid:1000 (2 connections)". Fails with NOT_ALLOWED if only others hold the scene.
    Reply<std::vector<std::string>> unload(std::string_view name, const ConnectionId& caller);

    /// Unloads at most `most` scenes that the caller's principal or connection holds and that no
    /// request has used for `idle`.
    std::vector<Unloaded> unload_idle(Clock::duration idle, std::size_t most,
                                      const ConnectionId& caller);

    struct Listed {
        NamedScene scene;
        std::string
            owner;  ///< the loader, or another owner or holder once the loader has dropped it
        Clock::duration age{};
        Clock::duration idle{};   ///< time since a request last used the scene
        std::size_t holders = 0;  ///< number of open connections that loaded or opened the scene
    };
    /// Returns the scenes that find() can return to the caller, by name.
    [[nodiscard]] std::vector<Listed> list(const ConnectionId& caller) const;

    /// Number of scenes: listed ones, and unlisted ones, which only connections hold.
    [[nodiscard]] std::size_t size() const { return entries_.size(); }
    struct Total {
        std::size_t scenes = 0;
        std::uint64_t bytes = 0;
    };
    /// Bytes of all scenes that somebody holds, each once.
    [[nodiscard]] std::uint64_t bytes() const;
    /// Returns number and bytes of the unlisted scenes.
    [[nodiscard]] Total unlisted() const;
    /// Returns advice on how to make room for scenes: to unload the principal's least recently used
    /// ones, if any, or to start raynestd with a larger `option`.
    [[nodiscard]] std::string remedy(const std::string& principal, std::string_view option) const;

private:
    struct Entry {
        NamedScene scene;
        std::string loader;  ///< the principal that loaded this content
        Clock::time_point loaded;
        mutable Clock::time_point used;
        bool listed = true;            ///< true: all clients find the scene by its name
        std::set<std::string> owners;  ///< principals that loaded the scene, not as temporary
        /// Connections of each principal; the value is true if it loaded the scene as temporary.
        std::map<std::string, std::map<std::uint64_t, bool>> holders;

        /// Returns the loader or, once it has dropped the scene, another owner, else a holder.
        [[nodiscard]] const std::string& owner() const;
        [[nodiscard]] bool held_by(const ConnectionId& caller) const;
        [[nodiscard]] bool temporary_of(const ConnectionId& caller) const;
        /// True if the scene counts towards the quotas of this principal.
        [[nodiscard]] bool charged_to(const std::string& principal) const;
        /// True if this principal may replace the scene's content: it is the only owner or, without
        /// owners, the only holder. Connections of other principals get the new content too.
        [[nodiscard]] bool only_of(const std::string& principal) const;
        [[nodiscard]] std::size_t connections() const;
        /// Drops the reference of the caller's connection; true if no reference is left.
        bool release(const ConnectionId& caller) noexcept;
    };
    /// Scenes by name. Of one name, at most one is listed, and a connection holds at most one.
    using Entries = std::multimap<std::string, Entry, std::less<>>;

    /// Returns the entry that the caller finds by this name, or the end. `entries` may be const.
    template <class AnyEntries>
    static auto resolve(AnyEntries& entries, std::string_view name, const ConnectionId& caller);
    [[nodiscard]] Entries::iterator listed(std::string_view name);
    Reply<void> check_quota(const Entry* changed, const ConnectionId& caller,
                            std::uint64_t bytes) const;
    Reply<std::shared_ptr<const HeldScene>> hold(std::shared_ptr<const Snapshot> snapshot,
                                                 const std::string& principal);

    Budget& budget_;
    const protocol::Limits limits_;
    const Now now_;
    Entries entries_;
    std::map<std::string, std::weak_ptr<const HeldScene>> by_digest_;
    std::uint64_t last_connection_ = 0;
};

}  // namespace raynest::server
