// A real raynestd for tests: own process, own port, stopped with the test; and a raw connection
// that can say anything to it. Every wait has a deadline: a hang is a failed test, never a stuck
// one.
#pragma once

#include "protocol/control.h"
#include "tests/patience.h"
#include "tests/temporary_folder.h"

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::test {

/// A line of the tally of hostile clients: what they did, how often, and what came of it.
void tally(std::string_view clients, std::size_t count, std::string_view outcome);

/// raynestd on a free loopback port, serving when the constructor returns.
class Daemon {
public:
    /// `descriptors_max` as `ulimit -n` would set it, 0: as it is here.
    explicit Daemon(const std::vector<std::string>& arguments = {},
                    std::size_t descriptors_max = 0);
    /// Stops it; the test fails when it does not end in time or not with 0.
    ~Daemon();
    Daemon(const Daemon&) = delete;

    [[nodiscard]] std::uint16_t port() const { return port_; }
    [[nodiscard]] pid_t pid() const { return pid_; }
    [[nodiscard]] const std::filesystem::path& folder() const { return folder_.path(); }
    void signal(int number) const;
    /// The exit code, once it has ended by itself; nothing when it runs after patience().
    std::optional<int> wait();
    /// Bytes of resident memory, now and at most so far.
    [[nodiscard]] std::uint64_t resident_bytes() const { return memory("VmRSS:"); }
    [[nodiscard]] std::uint64_t resident_bytes_max() const { return memory("VmHWM:"); }
    /// Open file descriptors.
    [[nodiscard]] std::size_t descriptors() const;
    /// Lines of its log that hold this text.
    [[nodiscard]] std::size_t logged(std::string_view text) const;

private:
    [[nodiscard]] std::uint64_t memory(std::string_view key) const;
    [[nodiscard]] std::string log() const;
    void end_by_force();

    TemporaryFolder folder_;
    pid_t pid_ = -1;
    std::uint16_t port_ = 0;
};

/// Runs raynestd to its end with its output caught.
struct Ended {
    int exit_code = -1;
    std::string output;  ///< stdout and stderr
};
Ended run_raynestd(const std::vector<std::string>& arguments);

/// One TCP connection to a daemon, byte by byte.
class Peer {
public:
    explicit Peer(const Daemon& daemon) : Peer(daemon.port()) {}
    explicit Peer(std::uint16_t port);
    ~Peer();
    Peer(const Peer&) = delete;

    /// False when the daemon has closed the connection.
    bool send(std::span<const std::byte> bytes);
    bool send(std::string_view text) { return send(std::as_bytes(std::span(text))); }
    template <class Native>
    bool say(std::uint64_t id, const Native& message) {
        return send_frame(protocol::encode(id, message).value());
    }
    bool send_frame(const protocol::Frame& frame);

    /// Takes up to `bytes` off the socket and forgets them; false at the end of the stream.
    bool receive_some(std::size_t bytes);

    /// The next frame; nothing at the end of the stream. Fails the test after patience().
    std::optional<protocol::Frame> read();
    /// The next frame of type Table of any request, others skipped; fails the test without one.
    template <class Table>
    protocol::Frame read_until() {
        return read_type(static_cast<std::uint16_t>(protocol::message_of<Table>));
    }
    /// The code of the next ERROR frame, other frames skipped; nothing at the end of the stream.
    std::optional<protocol::Code> read_error();
    /// Has the daemon closed? Skips what it still says.
    bool ends();
    /// HELLO and WELCOME.
    void greet(const wire::HelloT& hello = {});
    /// Does a PONG come? Skips what comes before.
    bool pongs();
    /// PING and its PONG: the connection lives.
    bool answers() { return say(1, wire::PingT{}) && pongs(); }
    /// Ends the connection without a FIN: the daemon sees a reset.
    void reset();
    /// Stops sending, goes on reading.
    void finish_sending();

private:
    protocol::Frame read_type(std::uint16_t type);

    int socket_ = -1;
    protocol::Limits limits_;
    protocol::FrameDecoder decoder_{limits_};
    std::vector<std::byte> pending_;  ///< received, not yet decoded
};

/// Loads a small built-in scene under the name "scene".
void load_scene(Peer& peer);
/// A daemon that holds that scene, and the connection that loaded it: for TEST_CASE_FIXTURE.
struct Served {
    explicit Served(const std::vector<std::string>& arguments = {});
    Daemon daemon;
    Peer peer{daemon};
};
/// A query of `rays` rays of that scene; the rays are still to be sent.
wire::QueryT query_of(std::uint64_t rays);
/// Rays [first, first + count) of such a query, all downwards.
protocol::Frame rays_frame(std::uint64_t id, std::uint64_t first, std::uint64_t count);
/// A counter of `raynest stats`.
double counter(Peer& peer, std::string_view name);
/// Waits until no job runs.
void wait_for_idle(Peer& peer);
/// A picture that takes minutes: something to interrupt.
wire::RenderT endless_render();

}  // namespace raynest::test
