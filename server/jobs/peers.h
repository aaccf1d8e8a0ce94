// The connections, and the one rule of who gives way when there is no place for a newcomer.
//
// A peer that pauses (it reads nothing, grants no credit, does not send what its requests wait for,
// stops in the middle of a frame) stays as long as nobody needs its place: it holds no worker, and
// of --memory at most its windows. When connections, jobs or memory run short, the principal that
// holds most of it gives way first, and of its peers the one on whose connection a whole frame
// moved longest ago; single bytes count for nothing. Two bounds keep that fair: a peer for which
// the daemon works, or that moved a frame within give_way_ms, stays; and no principal gives way to
// one that holds more than it does.
#pragma once

#include "protocol/limits.h"
#include "server/diag/metrics.h"
#include "server/jobs/job.h"
#include "server/store/budget.h"

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>

namespace raynest::server {

enum class Resource { connections, jobs, memory };

/// One connection, as the rule sees it.
class Peer {
public:
    Peer() = default;
    Peer(const Peer&) = delete;
    [[nodiscard]] virtual const std::string& principal() const = 0;
    /// Connections, jobs in flight, or bytes of --memory.
    [[nodiscard]] virtual std::uint64_t holds(Resource resource) const = 0;
    /// When a whole frame last moved, while the next move is the peer's; nothing while the daemon
    /// works for it.
    [[nodiscard]] virtual std::optional<Clock::time_point> paused_since() const = 0;
    /// Says why, where the socket takes it, and closes. All that it held is free afterwards.
    virtual void give_way(const protocol::Error& why) = 0;

protected:
    ~Peer() = default;
};

/// Io thread only.
class Peers {
public:
    using Now = std::function<Clock::time_point()>;
    enum class Whose { everybodys, own };

    Peers(const protocol::Limits& limits, Budget& budget, Metrics& metrics, Now now = Clock::now)
        : limits_(limits),
          budget_(budget),
          metrics_(metrics),
          now_(std::move(now)) {}
    Peers(const Peers&) = delete;

    void join(Peer& peer);
    /// Counts the peer under another principal, which its principal() names from now on.
    void move(Peer& peer, const std::string& principal);
    void leave(Peer& peer);
    [[nodiscard]] std::size_t size() const { return size_; }
    [[nodiscard]] std::size_t size_of(const std::string& principal) const;

    /// Makes room for `amount` more, which `newcomer` lacks. False, and nobody has given way, where
    /// those who may hold less than that.
    bool make_room(Resource resource, const std::string& newcomer, std::uint64_t amount = 1,
                   Whose whose = Whose::everybodys);
    /// The same for memory, where so many bytes are not free.
    void make_memory(std::uint64_t bytes, const std::string& newcomer);
    /// Bytes that make_memory() could free for `newcomer` beside those that are.
    [[nodiscard]] std::uint64_t reclaimable_bytes(const std::string& newcomer) const;
    /// The daemon ends and needs all places: whoever may give way does.
    void dismiss();

private:
    struct Choice {
        Peer* peer = nullptr;
        Clock::duration paused{};
        std::uint64_t held = 0;  ///< by all that may give way
    };
    [[nodiscard]] Choice choose(Resource resource, const std::string& newcomer, Whose whose) const;
    /// How long it has paused, if that is long enough.
    [[nodiscard]] std::optional<Clock::duration> paused(const Peer& peer,
                                                        Clock::time_point now) const;

    const protocol::Limits& limits_;
    Budget& budget_;
    Metrics& metrics_;
    const Now now_;
    std::map<std::string, std::set<Peer*>> peers_;  ///< by principal
    std::size_t size_ = 0;
};

}  // namespace raynest::server
