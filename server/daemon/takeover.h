// How one daemon takes the place of another that runs: its state folder and its listening sockets.
//
//   successor                                  predecessor
//   connects to DIR/successor  ──────────────► is it the same user?
//   "takeover 1"  ───────────────────────────► changes of scenes wait, running ones end, the
//                                              manifest is closed; all else goes on
//   ◄──────────── sockets, lock (SCM_RIGHTS) ─
//   opens the folder, and accepts connections
//   "serving"  ──────────────────────────────► accepts no more, ends its jobs, then itself
//   ◄──────────────────── end of the stream ──
//
// The sockets stay open all the time, so nobody is refused. If the successor ends before it serves,
// the predecessor opens the manifest again and goes on; it ends one that does not serve in time, for
// only then nobody else writes to the folder.
#pragma once

#include "engine/result.h"
#include "engine/system/child_process.h"
#include "server/net/asio.h"
#include "server/net/inherited.h"
#include "server/options/ready_file.h"

#include <sys/types.h>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <vector>

namespace raynest::server {

/// The predecessor's side: waits for a successor. Io thread only.
class SuccessorSocket {
public:
    /// The steps of the daemon.
    struct Acts {
        /// Lets no change of scenes begin, waits for those that run, closes the manifest, then
        /// calls the function on the io thread.
        std::function<void(std::function<void()>)> settle;
        std::function<std::vector<HandedSocket>()> sockets;
        /// The successor has ended before it serves; calls the function once changes go on.
        std::function<void(std::function<void()>)> go_on;
        std::function<void(pid_t)> give_way;  ///< it serves
    };
    /// Opens the socket in a state folder whose lock is `lock`. Fails with io_failed.
    static Result<std::unique_ptr<SuccessorSocket>> open(asio::io_context& io,
                                                         const std::filesystem::path& folder,
                                                         int lock, Acts acts);
    ~SuccessorSocket();
    SuccessorSocket(const SuccessorSocket&) = delete;
    /// True while a successor has the folder and the sockets.
    [[nodiscard]] bool is_handed() const {
        return phase_ == Phase::handed || phase_ == Phase::gone;
    }

private:
    SuccessorSocket(asio::io_context& io, std::filesystem::path folder, int lock, Acts acts)
        : folder_(std::move(folder)),
          lock_(lock),
          acts_(std::move(acts)),
          listening_(io),
          peer_(io),
          timer_(io) {}
    /// Makes the socket and its name, unless the name is that of this socket already.
    Result<void> listen();
    [[nodiscard]] bool has_name() const;
    void await_peer();
    void accept();
    void await_word();
    void hear();
    void settled();
    void lose_peer();
    void return_to_work();
    void end_peer() const;

    enum class Phase {
        alone,
        greeting,  ///< a peer has connected
        settling,
        deserted,   ///< the peer has ended meanwhile
        handed,     ///< it has the folder
        returning,  ///< it has ended since
        gone        ///< it serves
    };
    const std::filesystem::path folder_;
    const int lock_;
    const Acts acts_;
    asio::posix::stream_descriptor listening_;
    asio::posix::stream_descriptor peer_;
    asio::steady_timer timer_;
    std::uint64_t inode_ = 0;  ///< the inode of the socket's name
    pid_t pid_ = 0;
    Fd process_;  ///< that of the peer
    Phase phase_ = Phase::alone;
    bool peer_waits_ = false;  ///< for the end of Phase::returning
};

/// The successor's side: the daemon in whose place it comes. It goes on if this is destroyed before
/// serving().
class Predecessor {
public:
    /// Asks the daemon that uses a state folder for it; blocks until that has settled. Fails with
    /// io_failed, and that daemon then goes on.
    static Result<Predecessor> ask(const std::filesystem::path& folder);

    [[nodiscard]] StateLock take_lock() { return std::move(lock_); }
    [[nodiscard]] std::vector<HandedSocket> take_sockets() { return std::move(sockets_); }
    [[nodiscard]] pid_t pid() const { return pid_; }
    /// Tells it to accept no more.
    void serving() const;
    /// Readable once it has ended.
    [[nodiscard]] int descriptor() const { return stream_.get(); }

private:
    Predecessor() = default;
    Fd stream_;
    pid_t pid_ = 0;
    StateLock lock_;
    std::vector<HandedSocket> sockets_;
};

}  // namespace raynest::server
