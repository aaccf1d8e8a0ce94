// Scenes at moments of their animations, made for the requests that ask for one.
#pragma once

#include "engine/scene/edits/pose.h"
#include "server/jobs/scene_waker.h"
#include "server/security/caller.h"
#include "server/store/named_scene.h"

#include <chrono>
#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest::server {

/// Makes each once, and keeps the last few of each principal for a while: a client that asks for
/// one mostly asks again. They count towards --memory as requests of the principal do. Io thread
/// only.
class ScenePoser {
public:
    using Clock = std::chrono::steady_clock;
    using Ready = SceneWaker::Awake;

    /// Kept and being made, of each principal.
    static constexpr std::size_t kept_max = 4;
    static constexpr std::chrono::seconds kept_time{20};

    /// `post` runs a function on the io thread. `services` outlives this.
    ScenePoser(const Services& services, Post post) : services_(services), post_(std::move(post)) {}
    ScenePoser(const ScenePoser&) = delete;

    /// A scene that a request needs and that is not made yet.
    struct Wanted {
        NamedScene base;
        Moment moment;
        /// Scenes that find() has returned to the request before. While they are held, make() does not
        /// drop them, so that a request of several moments gets all.
        std::vector<std::shared_ptr<const HeldScene>> found = {};
    };

    /// Returns `base` at a moment, under its name and epoch. Fails as find_moment() does, and if it
    /// is not made yet: then take_wanted() says what lacks.
    Reply<NamedScene> find(const NamedScene& base, std::string_view animation, double seconds,
                           const Caller& caller);
    /// Returns the scene because of which find() has failed, once; call it before each request.
    [[nodiscard]] std::optional<Wanted> take_wanted() {
        auto found = std::exchange(found_, {});
        auto wanted = std::exchange(wanted_, std::nullopt);
        if (wanted) wanted->found = std::move(found);
        return wanted;
    }
    /// Makes it in a task of `principal`, then calls `ready` unless that has expired. While the
    /// principal has kept_max under way, it makes nothing and calls `ready` when one of them is
    /// done: to ask again.
    void make(const Wanted& wanted, const std::string& principal, std::weak_ptr<Ready> ready);
    /// Returns how many bytes of --memory are kept for a principal.
    [[nodiscard]] std::uint64_t held_by(const std::string& principal) const;
    /// Frees what nobody has used for kept_time.
    void drop_idle(Clock::time_point now = Clock::now());

private:
    struct Posed {
        std::string principal;
        std::string arena;  ///< the arena of the scene that it is made from
        Moment moment;
        std::shared_ptr<const HeldScene> held;  ///< null: it is being made
        Waiters waiting = {};
        Clock::time_point used = Clock::now();

        /// A request holds it: to let go of it here would free nothing.
        [[nodiscard]] bool is_in_use() const { return held == nullptr || held.use_count() > 1; }
    };
    struct Made;
    using Kept = std::list<Posed>;
    struct Own {
        Kept kept;
        Waiters queue = {};  ///< empty unless kept_max are under way
    };

    /// Returns null if there is none.
    Posed* place_of(const std::string& principal, const std::string& arena, const Moment& moment);
    [[nodiscard]] std::size_t under_way(const std::string& principal) const;
    void drop_all_but(std::size_t most, const std::string& principal);
    [[nodiscard]] tl::unexpected<protocol::Error> no_room(std::uint64_t bytes,
                                                          const std::string& principal) const;
    /// On any thread: its work grows with what moves.
    void pose_scene(const Snapshot& scene, const Moment& moment, const std::string& principal,
                    Made& made) const;
    void done(Kept::iterator posed, Made& made);

    const Services& services_;
    const Post post_;
    std::map<std::string, Own> own_;  ///< by principal
    std::optional<Wanted> wanted_;
    std::vector<std::shared_ptr<const HeldScene>> found_;  ///< since the last take_wanted()
};

}  // namespace raynest::server
