#include "tests/bench/load_test/echo.h"

#include <boost/asio/buffer.hpp>
#include <boost/asio/generic/stream_protocol.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/read.hpp>
#include <boost/asio/write.hpp>
#include <sys/socket.h>

#include <span>
#include <thread>
#include <utility>  // before Asio: Boost 1.74 needs std::exchange in C++20

namespace raynest::client {
namespace {

namespace asio = boost::asio;
using boost::system::error_code;

/// One connection of the Asio echo; held by its pending operation.
class Answering : public std::enable_shared_from_this<Answering> {
public:
    Answering(asio::generic::stream_protocol::socket socket, const EchoScript& script)
        : socket_(std::move(socket)),
          script_(script),
          request_(script.request_bytes) {}

    void read() {
        asio::async_read(socket_, asio::buffer(request_),
                         [self = shared_from_this()](const error_code& error, std::size_t) {
                             if (!error) self->write();
                         });
    }

private:
    void write() {
        asio::async_write(socket_, asio::buffer(script_.reply),
                          [self = shared_from_this()](const error_code& error, std::size_t) {
                              if (!error) self->read();
                          });
    }

    asio::generic::stream_protocol::socket socket_;
    const EchoScript& script_;
    std::vector<std::byte> request_;
};

class AsioEcho final : public Echo {
public:
    AsioEcho(std::vector<Descriptor> sockets, EchoScript script) : script_(std::move(script)) {
        for (Descriptor& socket : sockets) {
            sockaddr_storage name{};
            socklen_t size = sizeof name;
            (void)getsockname(socket.number(), reinterpret_cast<sockaddr*>(&name), &size);
            asio::generic::stream_protocol::socket stream(io_);
            stream.assign({name.ss_family, 0}, socket.release());
            std::make_shared<Answering>(std::move(stream), script_)->read();
        }
        thread_ = std::thread([this] { io_.run(); });
    }
    ~AsioEcho() override {
        io_.stop();
        thread_.join();
    }

private:
    const EchoScript script_;
    asio::io_context io_{1};
    std::thread thread_;
};

class ThreadEcho final : public Echo {
public:
    ThreadEcho(std::vector<Descriptor> sockets, EchoScript script)
        : script_(std::move(script)),
          sockets_(std::move(sockets)) {
        for (const Descriptor& socket : sockets_)
            threads_.emplace_back([this, number = socket.number()] { answer(number); });
    }
    ~ThreadEcho() override {
        for (const Descriptor& socket : sockets_) (void)shutdown(socket.number(), SHUT_RDWR);
        for (std::thread& thread : threads_) thread.join();
    }

private:
    void answer(int socket) const {
        std::vector<std::byte> request(script_.request_bytes);
        while (recv(socket, request.data(), request.size(), MSG_WAITALL) ==
               static_cast<ssize_t>(request.size())) {
            std::span<const std::byte> rest = script_.reply;
            while (!rest.empty()) {
                const ssize_t sent = send(socket, rest.data(), rest.size(), MSG_NOSIGNAL);
                if (sent <= 0) return;
                rest = rest.subspan(static_cast<std::size_t>(sent));
            }
        }
    }

    const EchoScript script_;
    const std::vector<Descriptor> sockets_;
    std::vector<std::thread> threads_;
};

}  // namespace

std::unique_ptr<Echo> echo_by_asio(std::vector<Descriptor> sockets, EchoScript script) {
    return std::make_unique<AsioEcho>(std::move(sockets), std::move(script));
}

std::unique_ptr<Echo> echo_by_threads(std::vector<Descriptor> sockets, EchoScript script) {
    return std::make_unique<ThreadEcho>(std::move(sockets), std::move(script));
}

}  // namespace raynest::client
