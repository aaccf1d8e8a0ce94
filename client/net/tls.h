// TLS on a connected, non-blocking socket: handshake, verification, reading and writing.
// Only tls.cpp includes OpenSSL.
#pragma once

#include "client/net/access.h"

#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <string>

namespace raynest::client {

class TlsStream {
public:
    /// Waits until the socket is ready for these poll() events.
    using Wait = std::function<Result<void>(short events)>;

    /// Does the handshake and checks the daemon's certificate, its chain and its name. Fails with
    /// exit code 3 and the remedy, and with 4 if the daemon refuses this client's certificate.
    static Result<std::unique_ptr<TlsStream>> open(int socket, const std::string& host,
                                                   const TlsOptions& options, const Wait& wait);
    ~TlsStream();
    TlsStream(const TlsStream&) = delete;

    enum class State { ready, wait, ended, broken };
    struct Moved {
        std::size_t bytes = 0;
        State state = State::ready;
    };
    /// Reads until the buffer is full or nothing more is there.
    Moved read(std::span<std::byte> buffer);
    /// Writes a part. After State::wait, repeat it with at least the same bytes.
    Moved write(std::span<const std::byte> bytes);
    /// False while written bytes wait for the socket: write again, if only nothing.
    [[nodiscard]] bool is_flushed() const { return is_flushed_; }
    /// True if bytes can be read of which poll() knows nothing.
    [[nodiscard]] bool has_bytes() const;
    /// Says why the stream broke.
    [[nodiscard]] const Failure& why_broken() const { return failure_; }

private:
    struct Parts;
    explicit TlsStream(std::unique_ptr<Parts> parts);
    State state_of(int result);

    std::unique_ptr<Parts> parts_;
    Failure failure_;
    bool is_flushed_ = true;
    bool drained_ = false;  ///< the last read took all records that had come
};

}  // namespace raynest::client
