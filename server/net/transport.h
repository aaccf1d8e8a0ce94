// The interface of transports: a stream of bytes in both directions.
//
//   Session ──► Transport ◄── SocketTransport (TCP, Unix)      a new transport is one file, and one
//                         ◄── TlsTransport                     row of the list in transports.cpp
//                         ◄── WebSocketTransport
//                         ◄── tests: MemoryTransport
//
// Io thread only.
// At most one read and one write run at a time; both end with an error after close().
#pragma once

#include "server/net/asio.h"
#include "server/net/unreadable.h"
#include "server/net/write_batch.h"
#include "server/security/principal.h"

#include <array>
#include <cstddef>
#include <optional>
#include <string>

namespace raynest::server {

/// A connection to a peer.
class Transport {
public:
    /// Two buffers of a read; it fills the first before the second.
    using ReadBuffers = std::array<asio::mutable_buffer, 2>;

    Transport() = default;
    Transport(const Transport&) = delete;
    virtual ~Transport() = default;

    /// The peer's identity, known before it sends anything; a certificate's subject after open().
    [[nodiscard]] virtual const PeerIdentity& peer() const = 0;

    /// Does the transport's own handshake before the first frame, such as TLS or the upgrade to
    /// WebSocket. It counts towards the time limit for Hello.
    virtual asio::awaitable<void> open(SystemError& /*error*/) { co_return; }

    /// Reads bytes; may wait for `wanted` bytes. Reads none where take_unreadable() has something to
    /// say, and where it has waited and the next call takes long: call it again in your turn. Gives
    /// others a turn where bytes cost more than to be copied, however many
    /// there are: the caller does not see that time. The caller keeps the arguments of read() and
    /// write() valid until they end.
    virtual asio::awaitable<std::size_t> read(const ReadBuffers& buffers, std::size_t wanted,
                                              SystemError& error) = 0;
    /// Says whose turns of the io thread the reads are from now on, where read() counts by itself.
    virtual void pays(const std::string& /*principal*/) {}
    /// True if the next read() decrypts or parses for as long as it takes to return bytes.
    [[nodiscard]] virtual bool reads_take_time() const { return false; }
    /// Returns the message that the last read() could not read; the session refuses it.
    virtual std::optional<Unreadable> take_unreadable() { return std::nullopt; }
    /// Writes at least one byte of `rest`.
    virtual asio::awaitable<std::size_t> write(const WriteBatch::Rest& rest,
                                               SystemError& error) = 0;
    /// Writes as many bytes as possible without waiting and returns their number, perhaps 0. Saves
    /// a pass through the event loop. No write may be running. The next write() reports errors.
    virtual std::size_t write_now(const WriteBatch::Rest& /*rest*/) { return 0; }

    /// Tells the peer that no more bytes follow.
    virtual asio::awaitable<void> finish_writing() { co_return; }
    /// Closes at once. Idempotent.
    virtual void close() = 0;

    /// True if the peer's machine or network no longer answers while bytes wait for it.
    virtual bool is_lost() { return false; }
    /// True if the peer has closed its end; tells it also while nobody reads.
    virtual bool has_left() { return false; }
};

}  // namespace raynest::server
