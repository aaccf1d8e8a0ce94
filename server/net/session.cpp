#include "server/net/session.h"

#include "protocol/keep_alive.h"
#include "server/log.h"
#include "server/net/lost_peer.h"

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
/// After the closing frame: time for the peer to read it and close.
constexpr seconds linger_time{1};
/// Before that: time for the outbox to leave.
constexpr seconds flush_time{5};
/// What a waiting frame costs beside its bytes.
constexpr std::uint64_t waiting_frame_bytes = 256;

constexpr Clock::time_point never = Clock::time_point::max();

/// Of what waits and no credit bounds.
std::uint64_t control_bytes(const protocol::Frame& frame) {
    if (frame.header.bulk_bytes != 0) return 0;
    return waiting_frame_bytes + protocol::header_bytes + frame.control.size();
}

/// Progress comes by itself, whatever its reader does: it shows no life.
bool shows_life(const protocol::Frame& frame) {
    return frame.header.type != static_cast<std::uint16_t>(wire::Message::Progress);
}

}  // namespace

void say_last(Socket& socket, const protocol::Error& error) {
    const protocol::Frame frame = protocol::encode_error(0, error, true);
    std::array<std::byte, protocol::header_bytes> header{};
    protocol::write_header(frame.header, header);
    const std::array<asio::const_buffer, 2> buffers = {
        asio::buffer(header), asio::buffer(frame.control.data(), frame.control.size())};
    SystemError ignored;
    socket.non_blocking(true, ignored);
    socket.write_some(buffers, ignored);
}

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
      greeting_deadline_(Clock::now() + milliseconds(services.limits.greeting_ms_max)),
      close_deadline_(never),
      moved_(Clock::now()) {
    protocol::tune_tcp(socket_.native_handle());
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

void Session::stop_if_lost() {
    if (!open_ || !is_lost(socket_.native_handle())) return;
    log(LogLevel::info, "lost", {{"principal", principal()}});
    stop();
}

std::uint64_t Session::holds(Resource resource) const {
    switch (resource) {
        case Resource::connections:
            return 1;
        case Resource::jobs:
            return conversation_.jobs();
        case Resource::memory:
            return conversation_.held_bytes();
    }
    return 0;
}

std::optional<Clock::time_point> Session::paused_since() const {
    const bool is_its_turn = open_ && !reading_ && conversation_.greeted() &&
                             !conversation_.closing() && conversation_.waits_for_client();
    return is_its_turn ? std::optional(moved_) : std::nullopt;
}

void Session::give_way(const protocol::Error& why) {
    if (!open_) return;
    // Within a frame that its socket does not take no words would reach it.
    if (backlog_ == 0) say_last(socket_, why);
    stop();
}

void Session::send(protocol::Frame frame) {
    if (!open_) return;
    // An answer that took long is not read yet: its reader's turn begins now.
    if (backlog_ == 0 && !reading_ && shows_life(frame)) moved_ = Clock::now();
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
        while (open_ && crowded()) co_await wait(room_);
        if (!open_) co_return;
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
    settle();
}

void Session::expect(std::size_t bytes) {
    if (bytes == std::exchange(expected_, bytes)) return;
    const int mark = static_cast<int>(bytes);
    // Unix sockets ignore it, and without it all that is lost is time.
    (void)setsockopt(socket_.native_handle(), SOL_SOCKET, SO_RCVLOWAT, &mark, sizeof mark);
}

void Session::take_frames(std::span<const std::byte> bytes) {
    bool moved = false;
    do {
        const auto taken = decoder_.feed(bytes);
        if (!taken) return conversation_.give_up(taken.error());
        bytes = bytes.subspan(*taken);
        if (decoder_.complete()) {
            if (!std::exchange(moved, true)) moved_ = Clock::now();
            conversation_.receive(decoder_.take());
            if (greeting_deadline_ != never && conversation_.greeted()) {
                greeting_deadline_ = never;
                decoder_.set_frame_bytes_max(services_.limits.frame_bytes_max);
            }
        }
    } while (open_ && !conversation_.closing() && !bytes.empty());
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
    if (gather_.empty() && !outbox_.empty()) gather_.load(outbox_);
    return !gather_.empty();
}

void Session::sent(std::size_t bytes) {
    services_.metrics.bytes_sent += bytes;
    backlog_ -= bytes;
    bool moved = false;
    gather_.consume(bytes, [&](const protocol::Frame& frame) {
        ++services_.metrics.frames_sent;
        control_backlog_ -= control_bytes(frame);
        moved = moved || shows_life(frame);
    });
    if (moved) moved_ = Clock::now();
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

Clock::time_point Session::next_deadline() const {
    if (conversation_.closing()) return close_deadline_;
    return std::min(greeting_deadline_, conversation_.runner().next_tick());
}

void Session::expire(Clock::time_point now) {
    if (now >= close_deadline_) return stop();
    if (conversation_.closing()) return;
    conversation_.runner().tick(now);
    if (now >= greeting_deadline_) {
        ++services_.metrics.timeouts;
        conversation_.give_up({Code::deadline, "no Hello came in time", 0});
    }
    settle();
}

}  // namespace raynest::server
