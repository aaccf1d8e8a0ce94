// Tests that a peer over TLS cannot keep the io thread: by records of one byte, or by messages of
// TLS itself. The peer is OpenSSL; its bytes are made beforehand, so that they come as fast as they
// can be read.
#include "server/net/tls_transport.h"
#include "tests/patience.h"
#include "tests/temporary_folder.h"

#include <doctest/doctest.h>
#include <openssl/ssl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

namespace raynest::test {
namespace {

namespace asio = server::asio;
using server::SystemError;

template <auto release>
using Free = protocol::Release<release>;

/// Makes a certificate and its key, as files of PEM.
server::TlsFiles make_files(const std::filesystem::path& folder) {
    const server::TlsFiles files{folder / "cert.pem", folder / "key.pem", {}};
    const std::string command =
        "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=test -days "
        "9 "
        "-keyout '" +
        files.key.string() + "' -out '" + files.certificate.string() + "' 2>/dev/null";
    REQUIRE(std::system(command.c_str()) == 0);
    return files;
}

/// A client whose socket is blocking, and a daemon's end of the connection.
class Pair {
public:
    explicit Pair(int version) {
        std::array<int, 2> ends{};
        REQUIRE(socketpair(AF_UNIX, SOCK_STREAM, 0, ends.data()) == 0);
        client_ = ends[0];
        context_ = server::TlsContext::load(make_files(folder_.path())).value();
        transport_ = std::make_unique<server::TlsTransport>(
            server::Socket(io_, {AF_UNIX, 0}, ends[1]), *context_);
        client_context_.reset(SSL_CTX_new(TLS_client_method()));
        SSL_CTX_set_max_proto_version(client_context_.get(), version);
        tls_.reset(SSL_new(client_context_.get()));
        SSL_set_fd(tls_.get(), client_);
        std::thread hands([this] { connected_ = SSL_connect(tls_.get()) == 1; });
        run([&]() -> asio::awaitable<void> { co_await transport_->open(error); });
        hands.join();
        REQUIRE(connected_);
        REQUIRE_FALSE(error);
        // From now on the words of the client are gathered.
        gathered_ = BIO_new(BIO_s_mem());
        SSL_set0_wbio(tls_.get(), gathered_);
    }
    Pair(const Pair&) = delete;
    ~Pair() {
        if (sender_.joinable()) sender_.join();
        close(client_);
    }

    /// Gathers records of one byte.
    void write_bytes(std::size_t count) {
        for (std::size_t i = 0; i < count; ++i) REQUIRE(SSL_write(tls_.get(), "x", 1) == 1);
    }
    void write_new_keys(std::size_t count) {
        for (std::size_t i = 0; i < count; ++i) {
            REQUIRE(SSL_key_update(tls_.get(), SSL_KEY_UPDATE_NOT_REQUESTED) == 1);
            REQUIRE(SSL_do_handshake(tls_.get()) == 1);
        }
    }
    /// Sends what was gathered, and ends the stream.
    void send() {
        SSL_shutdown(tls_.get());
        char* first = nullptr;
        const auto size = static_cast<std::size_t>(BIO_get_mem_data(gathered_, &first));
        sender_ = std::thread([this, sent = std::string(first, size)] {
            for (std::size_t at = 0; at < sent.size();) {
                const ssize_t part =
                    ::send(client_, sent.data() + at, sent.size() - at, MSG_NOSIGNAL);
                if (part <= 0) return;
                at += static_cast<std::size_t>(part);
            }
            shutdown(client_, SHUT_WR);
        });
    }

    /// Reads to the end, and counts the turns that others have meanwhile.
    void read() {
        bool ended = false;
        const std::function<void()> other = [&] {
            ++turns;
            if (!ended) asio::post(io_, other);
        };
        std::vector<std::byte> room(1 << 20);
        const server::Transport::ReadBuffers buffers{asio::buffer(room), asio::mutable_buffer()};
        asio::post(io_, other);
        run([&]() -> asio::awaitable<void> {
            while (!error) {
                const std::size_t got = co_await transport_->read(buffers, 1, error);
                bytes += got;
                largest = std::max(largest, got);
            }
            ended = true;
            transport_->close();
        });
    }

    SystemError error;
    std::size_t bytes = 0;    ///< that were read
    std::size_t largest = 0;  ///< bytes of one read
    std::size_t turns = 0;    ///< turns of others

private:
    void run(const std::function<asio::awaitable<void>()>& task) {
        asio::co_spawn(io_, task,
                       [](const std::exception_ptr& failure) { REQUIRE_FALSE(failure); });
        io_.restart();
        io_.run();
    }

    TemporaryFolder folder_;
    asio::io_context io_{1};
    int client_ = -1;
    bool connected_ = false;
    std::shared_ptr<const server::TlsContext> context_;
    std::unique_ptr<SSL_CTX, Free<SSL_CTX_free>> client_context_;
    std::unique_ptr<SSL, Free<SSL_free>> tls_;
    BIO* gathered_ = nullptr;  ///< what `tls_` has written
    std::unique_ptr<server::TlsTransport> transport_;
    std::thread sender_;
};

}  // namespace

TEST_CASE("Records of one byte do not keep the io thread, however fast they come") {
    constexpr std::size_t count = 400'000;  // a tenth of a second at the least
    Pair pair(TLS1_3_VERSION);
    pair.write_bytes(count);
    pair.send();
    pair.read();
    CHECK(pair.error == asio::error::eof);
    CHECK(pair.bytes == count);
    CHECK(pair.largest < count / 10);
}

TEST_CASE("New keys are taken now and then; a flood of them ends the connection") {
    Pair good(TLS1_3_VERSION);
    for (int i = 0; i < 30; ++i) {
        good.write_bytes(10);
        good.write_new_keys(2);
    }
    good.write_bytes(1);
    good.send();
    good.read();
    CHECK(good.error == asio::error::eof);
    CHECK(good.bytes == 301);

    Pair flood(TLS1_3_VERSION);
    flood.write_bytes(1);
    flood.write_new_keys(5000);
    flood.write_bytes(1);
    flood.send();
    flood.read();
    CHECK(flood.error == asio::error::connection_reset);
    CHECK(flood.bytes <= 1);
}

}  // namespace raynest::test
