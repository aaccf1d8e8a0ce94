// Writing to a TLS peer that does not read: what waits is told, sent once the peer reads, and given
// up once the peer is gone.
#include "client/net/tls.h"

#include "protocol/openssl.h"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <openssl/ssl.h>
#include <openssl/x509.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <csignal>
#include <memory>
#include <thread>
#include <vector>

namespace raynest::client {
namespace {

using protocol::Release;

/// A server's end of a socket pair with small buffers. It has a certificate of its own.
class Server {
public:
    Server() {
        std::signal(SIGPIPE, SIG_IGN);
        REQUIRE(socketpair(AF_UNIX, SOCK_STREAM, 0, ends_) == 0);
        const int small = 4096;
        for (const int end : ends_) setsockopt(end, SOL_SOCKET, SO_SNDBUF, &small, sizeof small);
        REQUIRE(fcntl(ends_[0], F_SETFL, O_NONBLOCK) == 0);
        const std::unique_ptr<EVP_PKEY, Release<EVP_PKEY_free>> key(EVP_EC_gen("P-256"));
        const std::unique_ptr<X509, Release<X509_free>> certificate(X509_new());
        X509_set_pubkey(certificate.get(), key.get());
        X509_gmtime_adj(X509_getm_notBefore(certificate.get()), 0);
        X509_gmtime_adj(X509_getm_notAfter(certificate.get()), 3600);
        REQUIRE(X509_sign(certificate.get(), key.get(), EVP_sha256()) != 0);
        context_.reset(SSL_CTX_new(TLS_server_method()));
        REQUIRE(SSL_CTX_use_certificate(context_.get(), certificate.get()) == 1);
        REQUIRE(SSL_CTX_use_PrivateKey(context_.get(), key.get()) == 1);
        tls_.reset(SSL_new(context_.get()));
        SSL_set_fd(tls_.get(), ends_[1]);
    }
    ~Server() {
        close(ends_[0]);
        if (ends_[1] >= 0) close(ends_[1]);
    }
    Server(const Server&) = delete;

    std::unique_ptr<TlsStream> open() {
        std::thread accepting([&] { SSL_accept(tls_.get()); });
        TlsOptions options;
        options.verify = false;
        auto stream = TlsStream::open(ends_[0], "localhost", options, [&](short events) {
            pollfd waiting{ends_[0], events, 0};
            return ::poll(&waiting, 1, 10000) == 1 ? Result<void>()
                                                   : fail(Exit::failed, "the peer is silent");
        });
        accepting.join();
        REQUIRE(stream);
        return std::move(*stream);
    }
    std::vector<std::byte> read(std::size_t size) {
        std::vector<std::byte> bytes(size);
        std::size_t got = 0;
        while (got < size) {
            const int count =
                SSL_read(tls_.get(), bytes.data() + got, static_cast<int>(size - got));
            REQUIRE(count > 0);
            got += static_cast<std::size_t>(count);
        }
        return bytes;
    }
    void leave() {
        close(ends_[1]);
        ends_[1] = -1;
    }

private:
    int ends_[2] = {-1, -1};
    std::unique_ptr<SSL_CTX, Release<SSL_CTX_free>> context_;
    std::unique_ptr<SSL, Release<SSL_free>> tls_;
};

/// More than the sockets hold, and less than the stream gathers.
std::vector<std::byte> some_bytes() {
    std::vector<std::byte> bytes(100'000);
    for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<std::byte>(i * 7);
    return bytes;
}

TEST_CASE("what a TLS stream has taken and the socket has not is sent by later writes") {
    Server server;
    const auto stream = server.open();
    const auto bytes = some_bytes();
    const auto moved = stream->write(bytes);
    CHECK(moved.state == TlsStream::State::ready);
    CHECK(moved.bytes == bytes.size());
    REQUIRE(!stream->is_flushed());
    std::vector<std::byte> seen;
    std::thread reading([&] { seen = server.read(bytes.size()); });
    while (!stream->is_flushed()) {
        CHECK(stream->write({}).state == TlsStream::State::ready);
        std::this_thread::yield();
    }
    reading.join();
    CHECK(seen == bytes);
}

TEST_CASE("a TLS stream whose peer is gone breaks, also with nothing left but what waits") {
    Server server;
    const auto stream = server.open();
    stream->write(some_bytes());
    REQUIRE(!stream->is_flushed());
    server.leave();
    CHECK(stream->write({}).state == TlsStream::State::broken);
    CHECK(!stream->why_broken().message.empty());
}

}  // namespace
}  // namespace raynest::client
