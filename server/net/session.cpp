#include "server/net/session.h"

#include "server/log.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <exception>
#include <utility>

namespace raynest::server {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr std::size_t stage_bytes = 4096;
constexpr std::size_t read_bytes_max = 256 << 10;
/// Of a bulk part so much is waited for at a time. A wakeup for every segment costs more than the
/// segment: up to twice the CPU time of a stream, whenever the reader keeps up with the sender.
constexpr std::size_t expected_bytes_max = 128 << 10;
/// A bulk part moves its deadline with each of these: 64 KiB/s over bulk_ms_max.
constexpr std::uint64_t bulk_checkpoint_bytes = 640ULL << 10;
/// After the closing frame: time for the peer to read it and close.
constexpr seconds linger_time{1};
/// Before that: time for the outbox to leave.
constexpr seconds flush_time{5};
/// A peer that died without a word is noticed this much after the watchdog, which counts and logs
/// one that lives and does not read, would have closed it.
constexpr int keepalive_s = 15;
/// What a waiting frame costs beside its bytes.
constexpr std::uint64_t waiting_frame_bytes = 256;

constexpr Clock::time_point never = Clock::time_point::max();

/// Options that TCP needs and Unix sockets do not know: failures do not matter.
void tune(Socket& socket, const protocol::Limits& limits) {
    const auto set = [&](int level, int name, int value) {
        (void)setsockopt(socket.native_handle(), level, name, &value, sizeof value);
    };
    set(IPPROTO_TCP, TCP_NODELAY, 1);
    set(SOL_SOCKET, SO_KEEPALIVE, 1);
    set(IPPROTO_TCP, TCP_KEEPIDLE, keepalive_s);
    set(IPPROTO_TCP, TCP_KEEPINTVL, keepalive_s);
    constexpr std::uint64_t most = 1ULL << 30;
    set(IPPROTO_TCP, TCP_USER_TIMEOUT,
        static_cast<int>(std::min(limits.idle_ms_max, most)) + 1000 * keepalive_s);
}

/// Of what waits and no credit bounds.
std::uint64_t control_bytes(const protocol::Frame& frame) {
    if (frame.header.bulk_bytes != 0) return 0;
    return waiting_frame_bytes + protocol::header_bytes + frame.control.size();
}

}  // namespace

Session::Session(asio::io_context& io, Socket socket, std::string principal,
                 const Services& services, const Engine& engine, OnClosed on_closed)
    : services_(services),
      on_closed_(std::move(on_closed)),
      socket_(std::move(socket)),
      wake_(io, never),
      room_(io, never),
      watchdog_(io, never),
      decoder_(services.limits),
      stage_(stage_bytes),
      conversation_(services, engine, *this, std::move(principal)),
      read_deadline_(Clock::now() + milliseconds(services.limits.greeting_ms_max)),
      close_deadline_(never) {
    tune(socket_, services.limits);
    SystemError ignored;
    socket_.non_blocking(true, ignored);
    decoder_.set_frame_bytes_max(services.limits.greeting_bytes_max);
    decoder_.set_admission(
        [this](const protocol::FrameHeader& header) { return conversation_.admit(header); });
}

void Session::start() {
    spawn(&Session::read_frames, "reader");
    spawn(&Session::write_frames, "writer");
    spawn(&Session::watch, "watchdog");
}

void Session::spawn(Part part, const char* name) {
    asio::co_spawn(socket_.get_executor(), (this->*part)(),
                   [self = shared_from_this(), name](const std::exception_ptr& failure) {
                       if (!failure) return;
                       try {
                           std::rethrow_exception(failure);
                       } catch (const std::exception& error) {
                           log(LogLevel::error, "connection_failed",
                               {{"part", name}, {"reason", error.what()}});
                       }
                       self->stop();
                   });
}

void Session::drain() {
    if (!open_) return;
    conversation_.drain();
    settle();
}

void Session::give_up() {
    if (!open_) return;
    conversation_.give_up({Code::draining, "", 0});
    wake_.cancel();
    settle();
}

void Session::stop() {
    if (!std::exchange(open_, false)) return;
    conversation_.abandon();
    SystemError ignored;
    socket_.close(ignored);
    wake_.cancel();
    room_.cancel();
    watchdog_.cancel();
    ++services_.metrics.connections_closed;
    on_closed_(shared_from_this());
}

void Session::send(protocol::Frame frame) {
    if (!open_) return;
    const std::uint64_t bytes = frame.header.frame_bytes();
    outbox_.push_back(std::move(frame));
    backlog_ += bytes;
    control_backlog_ += control_bytes(outbox_.back());
    if (!reading_) wake_.cancel();
}

asio::awaitable<void> Session::wait(asio::steady_timer& timer) {
    SystemError ignored;
    co_await timer.async_wait(asio::redirect_error(asio::use_awaitable, ignored));
}

// ---- reader -------------------------------------------------------------------------------------

asio::awaitable<void> Session::read_frames() {
    SystemError error;
    while (open_ && !conversation_.closing()) {
        // Whoever does not read its answers gets no more of its requests read.
        const Clock::time_point paused = Clock::now();
        while (open_ && crowded()) co_await wait(room_);
        if (!open_) co_return;
        // What we did not read was not late.
        if (read_deadline_ != never) read_deadline_ += Clock::now() - paused;
        co_await read_some(error);
        if (error) break;
    }
    if (open_ && !error) co_await linger();
    stop();
}

asio::awaitable<void> Session::read_some(SystemError& error) {
    // Bulk straight into its place, and what follows it in the same call.
    std::span<std::byte> bulk = decoder_.room();
    std::span<std::byte> stage = stage_;
    if (bulk.size() > read_bytes_max) {
        bulk = bulk.first(read_bytes_max);
        stage = {};
    }
    expect(std::clamp(bulk.size(), std::size_t{1}, expected_bytes_max));
    const std::array<asio::mutable_buffer, 2> parts = {asio::buffer(bulk.data(), bulk.size()),
                                                       asio::buffer(stage.data(), stage.size())};
    const std::size_t got =
        co_await socket_.async_read_some(parts, asio::redirect_error(asio::use_awaitable, error));
    if (error || !open_) co_return;
    services_.metrics.bytes_received += got;
    const std::size_t direct = std::min(got, bulk.size());
    decoder_.filled(direct);
    reading_ = true;
    take_frames(std::span<const std::byte>(stage).first(got - direct));
    reading_ = false;
    write_at_once();
    move_read_deadline(got);
    settle();
}

void Session::expect(std::size_t bytes) {
    if (bytes == std::exchange(expected_, bytes)) return;
    const int mark = static_cast<int>(bytes);
    // Unix sockets ignore it, and without it all that is lost is time.
    (void)setsockopt(socket_.native_handle(), SOL_SOCKET, SO_RCVLOWAT, &mark, sizeof mark);
}

void Session::take_frames(std::span<const std::byte> bytes) {
    do {
        const auto taken = decoder_.feed(bytes);
        if (!taken) return conversation_.give_up(taken.error());
        bytes = bytes.subspan(*taken);
        if (decoder_.complete()) {
            conversation_.receive(decoder_.take());
            if (conversation_.greeted()) {
                decoder_.set_frame_bytes_max(services_.limits.frame_bytes_max);
                // The next frame has its own time, also where it began in these bytes.
                read_deadline_ = never;
                checkpoint_bytes_ = 0;
            }
        }
    } while (open_ && !conversation_.closing() && !bytes.empty());
}

void Session::move_read_deadline(std::size_t got) {
    if (!conversation_.greeted()) return;
    const bool in_bulk = decoder_.in_bulk();
    if (!in_bulk) checkpoint_bytes_ = 0;
    if (decoder_.idle()) {
        read_deadline_ = never;
    } else if (in_bulk) {
        const bool first = std::exchange(checkpoint_bytes_, checkpoint_bytes_ + got) == 0;
        if (first || checkpoint_bytes_ >= bulk_checkpoint_bytes) {
            read_deadline_ = Clock::now() + milliseconds(services_.limits.bulk_ms_max);
            checkpoint_bytes_ = 1;
        }
    } else if (read_deadline_ == never) {
        read_deadline_ = Clock::now() + milliseconds(services_.limits.header_ms_max);
    }
}

asio::awaitable<void> Session::linger() {
    // Closing with unread bytes would reset the connection, and the peer might lose our last words.
    while (open_) {
        SystemError error;
        co_await socket_.async_read_some(asio::buffer(stage_),
                                         asio::redirect_error(asio::use_awaitable, error));
        if (error) break;
    }
}

// ---- writer -------------------------------------------------------------------------------------

bool Session::gather() {
    if (gather_.empty() && !outbox_.empty()) {
        gather_.load(outbox_);
        gathered_control_ = 0;
        for (const protocol::Frame& frame : gather_.frames())
            gathered_control_ += control_bytes(frame);
        write_started_ = Clock::now();
    }
    return !gather_.empty();
}

void Session::sent(std::size_t bytes) {
    services_.metrics.bytes_sent += bytes;
    backlog_ -= bytes;
    write_started_ = Clock::now();
    const std::size_t frames = gather_.frames().size();
    gather_.consume(bytes);
    if (!gather_.empty()) return;
    services_.metrics.frames_sent += frames;
    control_backlog_ -= std::exchange(gathered_control_, 0);
}

void Session::write_at_once() {
    if (!open_ || writing_ || !gather()) return;
    SystemError error;
    sent(socket_.write_some(gather_.rest(), error));
    // Whatever is wrong, the writer will meet it too.
    if (!gather_.empty() || !outbox_.empty() || conversation_.closing()) wake_.cancel();
    conversation_.runner().pump();
}

asio::awaitable<void> Session::write_frames() {
    while (open_) {
        if (!gather()) {
            if (conversation_.closing()) break;
            co_await wait(wake_);
            continue;
        }
        writing_ = true;
        settle();
        SystemError error;
        const std::size_t bytes = co_await socket_.async_write_some(
            gather_.rest(), asio::redirect_error(asio::use_awaitable, error));
        writing_ = false;
        if (!open_) co_return;
        if (error) {
            stop();
            co_return;
        }
        sent(bytes);
        room_.cancel();
        conversation_.runner().pump();
        settle();
    }
    if (!open_) co_return;
    SystemError ignored;
    socket_.shutdown(Socket::shutdown_send, ignored);
    close_deadline_ = Clock::now() + linger_time;
    settle();
}

// ---- watchdog -----------------------------------------------------------------------------------

asio::awaitable<void> Session::watch() {
    while (open_) {
        watchdog_.expires_at(next_deadline());
        co_await wait(watchdog_);
        if (open_) expire(Clock::now());
    }
}

void Session::settle() {
    if (!open_) return;
    conversation_.settle();
    if (conversation_.closing() && close_deadline_ == never)
        close_deadline_ = Clock::now() + flush_time;
    if (next_deadline() < watchdog_.expiry()) watchdog_.cancel();
}

bool Session::crowded() const {
    return backlog_ >= services_.limits.window_bytes ||
           control_backlog_ >= services_.limits.waiting_control_bytes_max;
}

Clock::time_point Session::read_deadline() const {
    return crowded() ? never : read_deadline_;
}

Clock::time_point Session::write_deadline() const {
    if (!writing_) return never;
    const bool holds_up = crowded() || conversation_.runner().blocked();
    const protocol::Limits& limits = services_.limits;
    return write_started_ +
           milliseconds(holds_up ? limits.slow_consumer_ms_max : limits.idle_ms_max);
}

Clock::time_point Session::next_deadline() const {
    if (conversation_.closing()) return close_deadline_;
    return std::min({read_deadline(), conversation_.runner().next_tick(), write_deadline()});
}

void Session::expire(Clock::time_point now) {
    if (now >= close_deadline_) return stop();
    if (conversation_.closing()) return;
    if (now >= write_deadline()) {
        // Its socket is full: no words would reach it.
        ++services_.metrics.slow_consumers;
        log(LogLevel::warn, "slow_consumer", {{"backlog_bytes", std::to_string(backlog_)}});
        return stop();
    }
    conversation_.runner().tick(now);
    if (now >= read_deadline()) {
        ++services_.metrics.timeouts;
        conversation_.give_up(
            {Code::deadline,
             conversation_.greeted() ? "a frame came too slowly" : "no Hello came in time", 0});
    }
    settle();
}

}  // namespace raynest::server
