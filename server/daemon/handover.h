// Both sides of a takeover (takeover.h) within a daemon: what it does with its state folder.
#pragma once

#include "server/daemon/takeover.h"
#include "server/jobs/change_gate.h"
#include "server/jobs/services.h"
#include "server/store/state_folder.h"

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

namespace raynest::server {

/// Io thread only.
class Handover {
public:
    struct Acts {
        std::function<std::vector<HandedSocket>()> sockets;
        std::function<void()> give_way;  ///< a successor accepts connections
    };
    Handover(asio::io_context& io, const Services& services)
        : io_(io),
          services_(services),
          timer_(io),
          predecessor_ends_(io) {}

    /// Where changes of scenes wait while a successor takes the folder over.
    [[nodiscard]] ChangeGate& changes() { return changes_; }
    /// True while a successor has the folder and the sockets, or serves already.
    [[nodiscard]] bool is_handed() const {
        return listening_ != nullptr && listening_->is_handed();
    }
    /// Waits for successors in the state folder, whose lock this is. Fails with io_failed.
    Result<void> await_successor(int lock, Acts acts);
    /// Tells the predecessor that this daemon accepts connections, and clears up once that has
    /// ended.
    void serve_after(Predecessor predecessor);

private:
    using Clock = std::chrono::steady_clock;
    /// Closes the state folder once no change of scenes runs, then calls `settled`.
    void settle(Clock::time_point until, std::function<void()> settled);
    void go_on(std::function<void()> done);

    asio::io_context& io_;
    const Services& services_;
    ChangeGate changes_;
    asio::steady_timer timer_;
    Clock::time_point asked_{};
    std::optional<Predecessor> predecessor_;
    asio::posix::stream_descriptor predecessor_ends_;
    std::unique_ptr<SuccessorSocket> listening_;
};

}  // namespace raynest::server
