// The scenes that the daemon holds, by name.
//
// A scene is immutable; jobs keep the one they started with. A scene stays while anything refers to
// it: its name, once for each principal that loaded it to stay, and every open connection that
// loaded or opened it. Unloading drops the name's reference and the caller's: then the name is free
// for others, and works on for the connections that still hold the scene. Replacing a name's
// content publishes a new epoch for all of them. Memory returns with the last holder.
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

/// An open connection: the principal that it belongs to, and its number among all connections.
struct ConnectionId {
    std::string principal;
    std::uint64_t connection = 0;  ///< from SceneStore::connect(); never used again
};

/// How a load publishes its scene.
struct Publication {
    bool replace = false;    ///< takes the place of other content of that name
    bool temporary = false;  ///< the name keeps nothing: the scene goes with its connections
};

/// Not thread-safe: belongs to the io thread.
class SceneStore {
public:
    using Clock = std::chrono::steady_clock;
    using Now = std::function<Clock::time_point()>;

    /// The quotas are principal_scenes_max and principal_scene_bytes_max.
    explicit SceneStore(Budget& budget, const protocol::Limits& limits = {}, Now now = Clock::now)
        : budget_(budget),
          limits_(limits),
          now_(std::move(now)) {}

    /// The number of a new connection.
    [[nodiscard]] std::uint64_t connect() { return ++last_connection_; }
    /// The connection has ended: drops its references. Idempotent, and needs no memory.
    void disconnect(const ConnectionId& caller) noexcept;

    /// May the caller's principal hold a scene of `bytes` under this name, beside its others? QUOTA
    /// says what to unload if not.
    [[nodiscard]] Reply<void> check_quota(std::string_view name, const ConnectionId& caller,
                                          std::uint64_t bytes) const;

    /// Gives `snapshot` a name, and the name and the caller a reference to it. Equal content under
    /// the same name is no change; other content is NAME_TAKEN unless `how.replace`, and
    /// NOT_ALLOWED where the name is another principal's too. QUOTA when it would be too much for
    /// the principal, RESOURCE_EXHAUSTED when the budget cannot hold it. Equal content under two
    /// names is held once.
    Reply<NamedScene> publish(const std::string& name, std::shared_ptr<const Snapshot> snapshot,
                              Publication how, const ConnectionId& caller);

    /// Is this content held already, under any name or by a running job?
    [[nodiscard]] bool holds(const std::string& hash) const;

    /// The scene of that name that the caller holds, else the one that the name means for all.
    /// `epoch` 0 takes the current one; any other must be it. SCENE_UNKNOWN says what to type.
    [[nodiscard]] Reply<NamedScene> find(std::string_view name, std::uint64_t epoch,
                                         const ConnectionId& caller) const;

    /// As find(), and the caller's connection holds it from now on. QUOTA as for loading it.
    Reply<NamedScene> open(std::string_view name, const ConnectionId& caller);

    struct Unloaded {
        std::string name;
        std::vector<std::string> holders;  ///< that hold it still, as unload() gives them
    };
    /// Drops the reference of the caller's principal to the name, and the caller's own; only the
    /// latter where the caller loaded the scene as temporary. Gives those that hold the scene
    /// still, one text per principal: "uid:1000 (2 connections)". NOT_ALLOWED where the scene is
    /// only others'.
    Reply<std::vector<std::string>> unload(std::string_view name, const ConnectionId& caller);

    /// Unloads at most `most` scenes that the caller's principal loaded to stay or that its
    /// connection holds, and that no request used for `idle`.
    std::vector<Unloaded> unload_idle(Clock::duration idle, std::size_t most,
                                      const ConnectionId& caller);

    struct Listed {
        NamedScene scene;
        std::string owner;  ///< the principal that loaded this content
        Clock::duration age{};
        Clock::duration idle{};   ///< since a request last used it
        std::size_t holders = 0;  ///< open connections that loaded or opened it
    };
    /// All names that mean something to the caller, in their order.
    [[nodiscard]] std::vector<Listed> list(const ConnectionId& caller) const;

    /// Scenes that a name means for all, or only the connections that still hold them.
    [[nodiscard]] std::size_t size() const { return entries_.size(); }
    struct Total {
        std::size_t scenes = 0;
        std::uint64_t bytes = 0;
    };
    /// The latter alone.
    [[nodiscard]] Total unlisted() const;
    /// What makes room for scenes, in words: unloading those that the principal has used the least
    /// recently, where there are any, or a larger value of raynestd's `option`.
    [[nodiscard]] std::string remedy(const std::string& principal, std::string_view option) const;

private:
    struct Entry {
        NamedScene scene;
        std::string owner;
        Clock::time_point loaded;
        mutable Clock::time_point used;
        bool listed = true;            ///< the name means this scene for everybody
        std::set<std::string> owners;  ///< principals whose loads keep it by its name
        /// Connections of each principal; true where one loaded it as temporary.
        std::map<std::string, std::map<std::uint64_t, bool>> holders;

        [[nodiscard]] bool held_by(const ConnectionId& caller) const;
        [[nodiscard]] bool temporary_of(const ConnectionId& caller) const;
        /// Does it count towards the quotas of this principal?
        [[nodiscard]] bool charged_to(const std::string& principal) const;
        /// May this principal put other content in its place? Connections of others follow.
        [[nodiscard]] bool only_of(const std::string& principal) const;
        [[nodiscard]] std::size_t connections() const;
        /// Drops the caller's own reference; true when that leaves none at all.
        bool release(const ConnectionId& caller) noexcept;
    };
    /// At most one of a name is listed, and a connection holds at most one of a name.
    using Entries = std::multimap<std::string, Entry, std::less<>>;

    /// What the name means to the caller: an iterator of `entries`, which may be const.
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
