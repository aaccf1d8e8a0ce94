// The connections, and the rule by which one of them is closed to make room for a newcomer.
//
// A peer pauses when it reads nothing, grants no credit, does not send data that its requests need,
// or stops in the middle of a frame. It stays connected while its place is not needed: it occupies
// no worker, and at most its windows of --memory. When connections, jobs or memory run short, the
// principal that holds most of the resource gives way first; among its peers, the one whose last
// whole frame is oldest. Single bytes do not count. Two bounds keep this fair: a peer stays while
// the daemon works for it, or if it moved a frame within give_way_ms; and no principal gives way to
// one that holds more.
#pragma once

#include "protocol/limits.h"
#include "server/ground/budget.h"
#include "server/ground/metrics.h"
#include "server/scheduling/job.h"

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>

namespace raynest::server {

enum class Resource { connections, jobs, memory };

class Peer;

/// Where Peers counts a peer, whatever its principal() returns.
class PeerPlace {
    friend class Peers;
    std::optional<std::map<std::string, std::set<Peer*>>::iterator> at_;  ///< empty: nowhere
};

/// The interface of a connection for this rule.
class Peer {
public:
    Peer() = default;
    Peer(const Peer&) = delete;
    [[nodiscard]] virtual const std::string& principal() const = 0;
    /// Returns how much the peer holds: connections, jobs in flight, or bytes of --memory.
    [[nodiscard]] virtual std::uint64_t holds(Resource resource) const = 0;
    /// Returns when the last whole frame was sent or received if the daemon waits for the peer;
    /// nothing while the daemon works for it.
    [[nodiscard]] virtual std::optional<Clock::time_point> paused_since() const = 0;
    /// Sends the reason if the socket accepts it without waiting, then closes. Frees all that the
    /// peer held.
    virtual void give_way(const protocol::Error& why) = 0;

    PeerPlace place;

protected:
    ~Peer() = default;
};

/// While one exists, the daemon works for a peer: memory that this needs is never taken from that
/// peer itself, whose requests are on the stack. `works` belongs to what says paused_since().
class WorksForPeer {
public:
    explicit WorksForPeer(int& works) : works_(works) { ++works_; }
    WorksForPeer(const WorksForPeer&) = delete;
    ~WorksForPeer() { --works_; }

private:
    int& works_;
};

/// The connections by principal. Io thread only.
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

    /// Counts the peer under its principal(). If memory runs out, it is not counted.
    void join(Peer& peer);
    /// Counts the peer under another principal, which its principal() returns soon. If memory runs
    /// out, nothing changes.
    void move(Peer& peer, const std::string& principal);
    void leave(Peer& peer);
    [[nodiscard]] std::size_t size() const { return size_; }
    [[nodiscard]] std::size_t size_of(const std::string& principal) const;
    /// Returns how much the peers of a principal hold.
    [[nodiscard]] std::uint64_t held_by(const std::string& principal, Resource resource) const;

    /// Closes paused peers until `amount` of the resource is freed for `newcomer`. Closes none and
    /// returns false if those that may give way hold less.
    bool make_room(Resource resource, const std::string& newcomer, std::uint64_t amount = 1,
                   Whose whose = Whose::everybodys);
    /// Called before peers give way: what is kept for speed alone goes first.
    void set_spares(std::function<void()> drop) { drop_spares_ = std::move(drop); }
    /// Reserves bytes of --memory; spares and paused peers give way if needed.
    [[nodiscard]] std::optional<Budget::Lease> reserve(std::uint64_t bytes,
                                                       const std::string& principal,
                                                       Use use = Use::passing);
    /// Closes paused peers while `newcomer` may not reserve so many bytes of --memory; none if
    /// closing all that may give way is not enough.
    void make_memory(std::uint64_t bytes, const std::string& newcomer, Use use = Use::passing);
    /// Returns the bytes that make_memory() could free for `newcomer`.
    [[nodiscard]] std::uint64_t reclaimable_bytes(const std::string& newcomer) const;
    /// Closes all paused peers, because the daemon drains: with this message, or the usual one.
    void dismiss(const std::string& why = {});

private:
    struct Choice {
        Peer* peer = nullptr;
        Clock::duration paused{};
        std::uint64_t held = 0;  ///< amount held by all peers that may give way
    };
    /// Returns how much a principal holds in all: of memory, its scenes and answers count too.
    [[nodiscard]] std::uint64_t weight_of(const std::string& principal, Resource resource) const;
    /// Returns the peer that gives way first; null if there is none.
    [[nodiscard]] Choice choose(Resource resource, const std::string& newcomer, Whose whose) const;
    /// Returns how long the peer has paused if that is at least give_way_ms.
    [[nodiscard]] std::optional<Clock::duration> paused(const Peer& peer,
                                                        Clock::time_point now) const;

    const protocol::Limits& limits_;
    std::function<void()> drop_spares_ = [] {};
    Budget& budget_;
    Metrics& metrics_;
    const Now now_;
    std::map<std::string, std::set<Peer*>> peers_;  ///< by principal
    std::size_t size_ = 0;
};

}  // namespace raynest::server
