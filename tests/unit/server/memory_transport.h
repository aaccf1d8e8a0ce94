// A transport in memory, whose other end the test moves: bytes go over in pieces of any size.
#pragma once

#include "server/sessions/connections.h"
#include "tests/golden/examples.h"
#include "tests/patience.h"
#include "tests/unit/server/small_daemon.h"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <deque>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace raynest::test {

/// Both ends share it.
struct MemoryWire {
    static constexpr std::size_t any = ~std::size_t{0};

    std::deque<std::byte> to_daemon;
    std::vector<std::byte> to_peer;
    std::size_t room = any;  ///< bytes that the peer takes before it pauses
    bool opens = true;       ///< the transport's own handshake ends
    bool finished = false;   ///< the daemon sends no more
    bool closed = false;     ///< the daemon has closed
    /// Bytes that one read or write moves, of at most so many; at least 1.
    std::function<std::size_t(std::size_t)> piece = [](std::size_t most) { return most; };
    std::function<void()> changed;  ///< to be called after the peer's end has changed
};

class MemoryTransport final : public server::Transport {
public:
    MemoryTransport(server::asio::io_context& io, std::shared_ptr<MemoryWire> wire,
                    std::string peer)
        : wire_(std::move(wire)),
          peer_{std::move(peer)},
          reader_(io, server::Clock::time_point::max()),
          writer_(io, server::Clock::time_point::max()) {
        wire_->changed = [this] {
            reader_.cancel();
            writer_.cancel();
        };
    }
    ~MemoryTransport() override {
        wire_->changed = [] {};
    }

    [[nodiscard]] const server::PeerIdentity& peer() const override { return peer_; }

    server::asio::awaitable<void> open(server::SystemError& error) override {
        while (!wire_->opens && !wire_->closed) co_await wait(reader_);
        if (wire_->closed) error = server::asio::error::operation_aborted;
    }
    server::asio::awaitable<std::size_t> read(const ReadBuffers& buffers, std::size_t /*wanted*/,
                                              server::SystemError& error) override {
        std::deque<std::byte>& bytes = wire_->to_daemon;
        while (bytes.empty() && !wire_->closed) co_await wait(reader_);
        if (wire_->closed) error = server::asio::error::operation_aborted;
        if (wire_->closed) co_return 0;
        const std::size_t most = std::min(bytes.size(), server::asio::buffer_size(buffers));
        const std::size_t count = wire_->piece(most);
        const auto end = bytes.begin() + static_cast<std::ptrdiff_t>(count);
        const std::vector<std::byte> moved(bytes.begin(), end);
        server::asio::buffer_copy(buffers, server::asio::buffer(moved));
        bytes.erase(bytes.begin(), end);
        co_return count;
    }
    server::asio::awaitable<std::size_t> write(const server::WriteBatch::Rest& rest,
                                               server::SystemError& error) override {
        while (wire_->room == 0 && !wire_->closed) co_await wait(writer_);
        if (wire_->closed) error = server::asio::error::operation_aborted;
        co_return wire_->closed ? 0 : write_now(rest);
    }
    std::size_t write_now(const server::WriteBatch::Rest& rest) override {
        const std::size_t most = std::min(wire_->room, server::asio::buffer_size(rest));
        if (most == 0) return 0;
        const std::size_t count = wire_->piece(most);
        const std::size_t before = wire_->to_peer.size();
        wire_->to_peer.resize(before + count);
        server::asio::buffer_copy(server::asio::buffer(wire_->to_peer.data() + before, count),
                                  rest);
        if (wire_->room != MemoryWire::any) wire_->room -= count;
        return count;
    }
    server::asio::awaitable<void> finish_writing() override {
        wire_->finished = true;
        co_return;
    }
    void close() override {
        wire_->closed = true;
        wire_->changed();
    }

private:
    static server::asio::awaitable<void> wait(server::asio::steady_timer& timer) {
        server::SystemError ignored;
        co_await timer.async_wait(
            server::asio::redirect_error(server::asio::use_awaitable, ignored));
    }

    const std::shared_ptr<MemoryWire> wire_;
    const server::PeerIdentity peer_;
    server::asio::steady_timer reader_;
    server::asio::steady_timer writer_;
};

/// The peer's end.
class MemoryPeer {
public:
    explicit MemoryPeer(const protocol::Limits& limits) : limits_(limits) {}

    void send(std::span<const std::byte> bytes) {
        wire->to_daemon.insert(wire->to_daemon.end(), bytes.begin(), bytes.end());
        wire->changed();
    }
    void send_frame(const protocol::Frame& frame) { send(golden::wire_bytes(frame)); }
    template <class Native>
    void say(std::uint64_t id, const Native& message) {
        send_frame(protocol::encode(id, message).value());
    }
    /// Takes so many bytes more off the wire.
    void make_room(std::size_t bytes) {
        wire->room = bytes;
        wire->changed();
    }
    /// The frames that have come as a whole since the last call.
    std::vector<protocol::Frame> take_frames() {
        std::vector<protocol::Frame> frames;
        std::span<const std::byte> bytes = wire->to_peer;
        while (!bytes.empty()) {
            bytes = bytes.subspan(decoder_.feed(bytes).value());
            if (decoder_.complete()) frames.push_back(decoder_.take());
        }
        wire->to_peer.clear();
        return frames;
    }

    const std::shared_ptr<MemoryWire> wire = std::make_shared<MemoryWire>();

private:
    const protocol::Limits limits_;
    protocol::FrameDecoder decoder_{limits_};
};

/// A daemon whose connections are in memory.
class MemoryDaemon {
public:
    explicit MemoryDaemon(const protocol::Limits& within = {},
                          server::Authenticator authenticator = server::authenticate)
        : daemon(within),
          connections(io, daemon.services, daemon.engine, authenticator) {}
    ~MemoryDaemon() {
        connections.close_with_error({server::Code::draining, "", 0});
        settle();
    }

    std::unique_ptr<MemoryPeer> connect(const std::string& name = "memory", bool opens = true) {
        auto peer = std::make_unique<MemoryPeer>(daemon.limits);
        peer->wire->opens = opens;
        connections.accept(std::make_unique<MemoryTransport>(io, peer->wire, name),
                           server::Descriptors::free);
        settle();
        return peer;
    }
    /// Runs what can run without time passing.
    void settle() {
        do {
            io.restart();
        } while (io.poll() != 0 || daemon.step());
    }
    /// The same, and waits so long for what else comes.
    void settle_for(std::chrono::milliseconds time) {
        io.restart();
        io.run_for(time);
        settle();
    }

    SmallDaemon daemon;
    server::asio::io_context io{1};
    server::Connections connections;
};

}  // namespace raynest::test
