// What a session needs of a connection: a stream of bytes in both directions, whatever carries it.
//
//   Session ──► Transport ◄── SocketTransport (TCP, Unix)      a new transport is one file, and one
//                         ◄── tests: MemoryTransport           row of the list in transports.cpp
//
// Frames lie in the stream in any way: a transport that has messages of its own, as WebSocket does,
// ends them wherever it likes. Everything runs on the io thread. At most one read and one write are
// under way at a time; both end with an error after close().
#pragma once

#include "server/net/asio.h"
#include "server/net/write_batch.h"
#include "server/principal.h"

#include <array>
#include <cstddef>

namespace raynest::server {

class Transport {
public:
    /// A read fills the first buffer before the second.
    using ReadBuffers = std::array<asio::mutable_buffer, 2>;

    Transport() = default;
    Transport(const Transport&) = delete;
    virtual ~Transport() = default;

    /// The peer as this transport knows it, before it has said anything.
    [[nodiscard]] virtual const PeerIdentity& peer() const = 0;

    /// Exchanges what the transport itself needs before the first frame: a TLS handshake, the
    /// upgrade to WebSocket. The time for Hello includes it.
    virtual asio::awaitable<void> open(SystemError& /*error*/) { co_return; }

    /// Reads at least one byte; may wait until `wanted` bytes are there. The arguments of read()
    /// and write() stay valid until they end.
    virtual asio::awaitable<std::size_t> read(const ReadBuffers& buffers, std::size_t wanted,
                                              SystemError& error) = 0;
    /// Writes at least one byte of `rest`.
    virtual asio::awaitable<std::size_t> write(const WriteBatch::Rest& rest,
                                               SystemError& error) = 0;
    /// Writes what leaves without waiting, perhaps nothing; only while no write is under way. This
    /// saves the way through the loop where it works; errors are left to the next write().
    virtual std::size_t write_now(const WriteBatch::Rest& /*rest*/) { return 0; }

    /// Tells the peer that nothing more will come.
    virtual asio::awaitable<void> finish_writing() { co_return; }
    /// Closes at once. Idempotent.
    virtual void close() = 0;

    /// True if the peer's machine or network no longer answers while bytes wait for it.
    virtual bool is_lost() { return false; }
};

}  // namespace raynest::server
