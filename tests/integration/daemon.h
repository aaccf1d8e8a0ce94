// A real raynestd for tests, with its own process and port, stopped with the test; and a raw
// connection that can send it any bytes. Every wait has a deadline: a hang fails the test instead
// of blocking it.
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

/// Prints a line about hostile clients: their action, its count and the outcome.
void tally(std::string_view clients, std::size_t count, std::string_view outcome);

/// A raynestd on a free loopback port; ready when the constructor returns.
class Daemon {
public:
    /// `descriptors_max` is the limit that `ulimit -n` would set; 0 keeps the current one.
    explicit Daemon(const std::vector<std::string>& arguments = {},
                    std::size_t descriptors_max = 0);
    /// Stops the daemon; the test fails if it does not end in time and with 0.
    ~Daemon();
    Daemon(const Daemon&) = delete;

    [[nodiscard]] std::uint16_t port() const { return port_; }
    [[nodiscard]] pid_t pid() const { return pid_; }
    [[nodiscard]] const std::filesystem::path& folder() const { return folder_.path(); }
    void signal(int number) const;
    /// Returns the exit code once the daemon has ended by itself; nothing after patience().
    std::optional<int> wait();
    /// Bytes of resident memory: current, and peak.
    [[nodiscard]] std::uint64_t resident_bytes() const { return memory("VmRSS:"); }
    [[nodiscard]] std::uint64_t resident_bytes_max() const { return memory("VmHWM:"); }
    /// Number of open file descriptors.
    [[nodiscard]] std::size_t descriptors() const;
    /// Number of log lines that contain this text.
    [[nodiscard]] std::size_t logged(std::string_view text) const;

private:
    [[nodiscard]] std::uint64_t memory(std::string_view key) const;
    [[nodiscard]] std::string log() const;
    void end_by_force();

    TemporaryFolder folder_;
    pid_t pid_ = -1;
    std::uint16_t port_ = 0;
};

/// The result of a raynestd run to its end.
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

    /// Sends bytes; false if the daemon has closed the connection.
    bool send(std::span<const std::byte> bytes);
    bool send(std::string_view text) { return send(std::as_bytes(std::span(text))); }
    template <class Native>
    bool say(std::uint64_t id, const Native& message) {
        return send_frame(protocol::encode(id, message).value());
    }
    bool send_frame(const protocol::Frame& frame);

    /// Receives and discards up to `bytes` bytes; false at the end of the stream.
    bool receive_some(std::size_t bytes);

    /// Returns the next frame; nothing at the end of the stream. Fails the test after patience().
    std::optional<protocol::Frame> read();
    /// Returns the next frame of type Table of any request and skips others; fails the test without
    /// one.
    template <class Table>
    protocol::Frame read_until() {
        return read_type(static_cast<std::uint16_t>(protocol::message_of<Table>));
    }
    /// Returns the code of the next ERROR frame and skips others; nothing at the end of the stream.
    std::optional<protocol::Code> read_error();
    /// Skips frames to the end of the stream; true if the daemon has closed.
    bool ends();
    /// Exchanges HELLO and WELCOME.
    void greet(const wire::HelloT& hello = {});
    /// Skips frames up to a PONG; true if one comes.
    bool pongs();
    /// Sends a PING; true if its PONG comes, so the connection works.
    bool answers() { return say(1, wire::PingT{}) && pongs(); }
    /// Ends the connection without a FIN: the daemon sees a reset.
    void reset();
    /// Stops sending but continues reading.
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
/// Returns a query of `rays` rays of that scene; the rays are sent separately.
wire::QueryT query_of(std::uint64_t rays);
/// Returns rays [first, first + count) of such a query, all downwards.
protocol::Frame rays_frame(std::uint64_t id, std::uint64_t first, std::uint64_t count);
/// Returns a counter of `raynest stats`.
double counter(Peer& peer, std::string_view name);
/// Waits until no job runs.
void wait_for_idle(Peer& peer);
/// Returns a picture that takes minutes, to be interrupted.
wire::RenderT endless_render();

}  // namespace raynest::test
