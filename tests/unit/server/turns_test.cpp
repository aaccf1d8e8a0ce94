// Tests whose turns of the io thread are used, and by what.
#include "server/net/turns.h"

#include "server/http/stream.h"

#include <doctest/doctest.h>

#include <array>
#include <chrono>
#include <memory>
#include <string>
#include <thread>

namespace raynest::server {
namespace {

const auto ann = std::make_shared<const std::string>("ann");

void keep_the_thread() {
    std::this_thread::sleep_for(2 * turn_time);
}

TEST_CASE("a scope uses the turn of its principal, less what is counted within it") {
    asio::io_context io;
    Turns& turns = asio::use_service<Turns>(io);
    {
        const TurnMeter meter(turns, ann);
        keep_the_thread();
        CHECK_FALSE(turns.is_over("ann"));
    }
    CHECK(turns.is_over("ann"));
    io.run();
    CHECK_FALSE(turns.is_over("ann"));
    {
        const TurnMeter meter(turns, ann);
        keep_the_thread();
        turns.spend("bob", std::chrono::hours(1));
    }
    CHECK_FALSE(turns.is_over("ann"));
    CHECK(turns.is_over("bob"));
    {
        const TurnMeter meter(turns, nullptr);
        keep_the_thread();
        TurnMeter::count_present();
    }
    CHECK_FALSE(turns.is_over("ann"));
}

/// A stream whose peer has sent much.
struct Fed {
    explicit Fed(asio::io_context& io) : peer(io), stream(connect(io)) {
        asio::write(peer, asio::buffer(std::string(1000, 'x')));
    }
    Socket connect(asio::io_context& io) {
        asio::ip::tcp::acceptor acceptor(io, {asio::ip::address_v4::loopback(), 0});
        asio::ip::tcp::socket near(io), far(io);
        far.connect(acceptor.local_endpoint());
        acceptor.accept(near);
        peer = Socket(std::move(far));
        return Socket(std::move(near));
    }

    Socket peer;
    HttpStream stream;
};

TEST_CASE("what follows a read uses the turn, and the next read waits for another") {
    asio::io_context io;
    Turns& turns = asio::use_service<Turns>(io);
    Fed fed(io);
    fed.stream.pays("ann");
    std::array<char, 10> bytes;
    int reads = 0;
    const auto read = [&](auto next) {
        fed.stream.async_read_some(asio::buffer(bytes), [&, next](SystemError error, std::size_t) {
            CHECK_FALSE(error);
            ++reads;
            next();
        });
    };
    read([] {});
    io.poll();
    CHECK(reads == 1);
    CHECK_FALSE(turns.is_over("ann"));
    // A read within what follows a read, as those of Beast.
    io.restart();
    read([&] {
        keep_the_thread();
        read([] {});
        CHECK(turns.left("ann") == Turns::Clock::duration());
    });
    while (reads < 2) io.poll_one();
    CHECK(reads == 2);
    CHECK(turns.is_over("ann"));
    io.poll();
    CHECK(reads == 3);
    // Others' reads do not wait in that line.
    keep_the_thread();
    turns.spend("ann", turn_time);
    fed.stream.pays("bob");
    io.restart();
    read([] {});
    CHECK(turns.left("bob") == turn_time);
    io.poll();
    CHECK(reads == 4);
}

}  // namespace
}  // namespace raynest::server
