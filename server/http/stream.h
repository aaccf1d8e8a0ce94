// The stream under HTTP and WebSocket: a TCP socket, with TLS or without. Beast reads and writes it
// as it does Asio's own sockets.
#pragma once

#include "server/http/beast.h"
#include "server/net/tls_socket.h"
#include "server/net/turns.h"

#include <cstddef>
#include <memory>
#include <string>
#include <utility>

namespace raynest::server {

/// Its reads and writes are turns of a principal. Beast handles much between two of them of which
/// nobody else learns: headers, control frames and their answers, empty fragments.
///
/// Movable. Io thread only.
class HttpStream {
public:
    using executor_type = Socket::executor_type;

    explicit HttpStream(Socket socket) : plain_(std::move(socket)) {}
    explicit HttpStream(std::unique_ptr<TlsSocket> tls)
        : plain_(tls->socket().get_executor()),
          tls_(std::move(tls)) {}

    [[nodiscard]] executor_type get_executor() { return socket().get_executor(); }
    [[nodiscard]] Socket& socket() { return tls_ ? tls_->socket() : plain_; }
    /// Null without TLS.
    [[nodiscard]] TlsSocket* tls() { return tls_.get(); }
    /// As TlsSocket::has_unsent().
    [[nodiscard]] bool has_unsent() const { return tls_ && tls_->has_unsent(); }
    /// True if bytes can be read of which the socket knows nothing.
    [[nodiscard]] bool has_bytes() const { return tls_ && tls_->has_bytes(); }
    /// Whose turns its reads and writes are from now on.
    void pays(const std::string& principal) {
        if (!payer_ || *payer_ != principal)
            payer_ = std::make_shared<const std::string>(principal);
    }
    [[nodiscard]] const std::shared_ptr<const std::string>& payer() const { return payer_; }
    [[nodiscard]] Turns& turns() { return Turns::of(socket()); }
    void spend(Turns::Clock::duration time) {
        if (payer_) turns().spend(*payer_, time);
    }
    void close() {
        SystemError ignored;
        socket().close(ignored);
    }
    void finish_writing() {
        SystemError ignored;
        if (tls_)
            tls_->finish_writing();
        else
            plain_.shutdown(Socket::shutdown_send, ignored);
    }

    template <class Buffers, class Token>
    auto async_read_some(const Buffers& buffers, Token&& token)
        -> BOOST_ASIO_INITFN_RESULT_TYPE(Token, void(SystemError, std::size_t)) {
        return asio::async_compose<Token, void(SystemError, std::size_t)>(
            Operation<Buffers, true>{this, buffers}, token, socket());
    }
    template <class Buffers, class Token>
    auto async_write_some(const Buffers& buffers, Token&& token)
        -> BOOST_ASIO_INITFN_RESULT_TYPE(Token, void(SystemError, std::size_t)) {
        return asio::async_compose<Token, void(SystemError, std::size_t)>(
            Operation<Buffers, false>{this, buffers}, token, socket());
    }

    // These do not wait: they fail with would_block.
    template <class Buffers>
    std::size_t read_some(const Buffers& buffers, SystemError& error) {
        return tls_ ? now<true>(buffers, error) : plain_.read_some(buffers, error);
    }
    template <class Buffers>
    std::size_t write_some(const Buffers& buffers, SystemError& error) {
        return tls_ ? now<false>(buffers, error) : plain_.write_some(buffers, error);
    }
    template <class Buffers>
    std::size_t read_some(const Buffers& buffers) {
        return thrown([&](SystemError& error) { return read_some(buffers, error); });
    }
    template <class Buffers>
    std::size_t write_some(const Buffers& buffers) {
        return thrown([&](SystemError& error) { return write_some(buffers, error); });
    }

private:
    /// A read or write that waits for the socket.
    template <class Buffers, bool reads>
    struct Operation {
        enum class State { begun, in_line, waits, done };

        HttpStream* stream;
        Buffers buffers;
        State state = State::begun;
        SystemError result = {};
        std::size_t bytes = 0;

        template <class Self>
        void operator()(Self& self, SystemError error = {}, std::size_t count = 0) {
            if (state == State::begun && stream->must_wait()) {
                state = State::in_line;
                return stream->turns().stand_in_line(*stream->payer_)->async_wait(std::move(self));
            }
            // The end of the wait in line is no error of the stream.
            if (state == State::in_line) error = {};
            const State before = std::exchange(state, State::waits);
            if (before == State::done) return complete(self, result, bytes);
            if (!stream->tls_) {
                if (before == State::waits) return complete(self, error, count);
                const Buffers all = buffers;
                if constexpr (reads)
                    return stream->plain_.async_read_some(all, std::move(self));
                else
                    return stream->plain_.async_write_some(all, std::move(self));
            }
            if (error) return complete(self, error, 0);
            TlsSocket::Outcome outcome{};
            bytes = stream->template now<reads>(buffers, result, &outcome);
            if (result == asio::error::would_block) {
                Socket& socket = stream->socket();
                const auto what = outcome == TlsSocket::Outcome::wait_write ? Socket::wait_write
                                                                            : Socket::wait_read;
                return socket.async_wait(what, std::move(self));
            }
            if (before != State::begun) return complete(self, result, bytes);
            // An operation must not complete within the call that begins it.
            state = State::done;
            asio::post(stream->get_executor(), std::move(self));
        }
        /// Counts what is done then, up to the next read or write.
        template <class Self>
        void complete(Self& self, SystemError error, std::size_t count) {
            const TurnMeter meter(stream->turns(), stream->payer_);
            self.complete(error, count);
        }
    };

    /// True if the next read or write has to wait in line.
    [[nodiscard]] bool must_wait() {
        TurnMeter::count_present();
        return payer_ && turns().is_over(*payer_);
    }

    /// Reads or writes over TLS without waiting.
    template <bool reads, class Buffers>
    std::size_t now(const Buffers& buffers, SystemError& error,
                    TlsSocket::Outcome* outcome = nullptr) {
        error = {};
        if (asio::buffer_size(buffers) == 0) return 0;
        if (!socket().is_open()) error = asio::error::operation_aborted;
        if (error) return 0;
        std::size_t bytes = 0;
        TlsSocket::Outcome ended{};
        if constexpr (reads)
            ended = read_first(buffers, bytes);
        else
            ended = tls_->write_some(buffers, bytes);
        using Outcome = TlsSocket::Outcome;
        if (ended == Outcome::ended) error = asio::error::eof;
        if (ended == Outcome::failed) error = asio::error::connection_reset;
        if (ended == Outcome::wait_read || ended == Outcome::wait_write)
            error = asio::error::would_block;
        if (outcome != nullptr) *outcome = ended;
        return bytes;
    }
    /// Reads into the first buffer that is not empty.
    template <class Buffers>
    TlsSocket::Outcome read_first(const Buffers& buffers, std::size_t& bytes) {
        const auto end = asio::buffer_sequence_end(buffers);
        for (auto buffer = asio::buffer_sequence_begin(buffers); buffer != end; ++buffer) {
            const asio::mutable_buffer part(*buffer);
            if (part.size() != 0) return tls_->read(part.data(), part.size(), bytes);
        }
        return TlsSocket::Outcome::done;
    }
    template <class Call>
    static std::size_t thrown(Call call) {
        SystemError error;
        const std::size_t bytes = call(error);
        if (error) throw boost::system::system_error(error);
        return bytes;
    }

    std::shared_ptr<const std::string> payer_;  ///< null: nobody
    Socket plain_;
    std::unique_ptr<TlsSocket> tls_;  ///< null: `plain_` is the connection
};

// What Beast's WebSocket asks of a stream at the end of a connection.

inline void teardown(beast::role_type /*role*/, HttpStream& stream, SystemError& error) {
    stream.finish_writing();
    stream.socket().close(error);
}
template <class Handler>
void async_teardown(beast::role_type role, HttpStream& stream, Handler&& handler) {
    if (TlsSocket* tls = stream.tls()) tls->finish_writing();
    beast::websocket::async_teardown(role, stream.socket(), std::forward<Handler>(handler));
}
inline void beast_close_socket(HttpStream& stream) {
    stream.close();
}

}  // namespace raynest::server
