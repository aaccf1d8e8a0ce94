#include "server/sessions/session.h"

#include "server/ground/io_turn.h"
#include "server/ground/limited_log.h"
#include "server/ground/log.h"
#include "server/sessions/connections.h"

#include <algorithm>
#include <exception>
#include <utility>

namespace raynest::server {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr std::size_t stage_bytes = 4096;
constexpr std::size_t read_bytes_max = 256 << 10;
/// Time to write the outbox once the conversation is closing.
constexpr seconds flush_time{5};
/// The same for a peer that is admitted no more.
constexpr std::chrono::milliseconds soon{700};
/// Time after that for the peer to read the last frame and to close.
constexpr seconds linger_time{1};

/// Damaged messages of a connection in a minute; one more ends it.
constexpr unsigned damaged_messages_max = 64;

constexpr Clock::time_point never = Clock::time_point::max();

/// Returns the memory of a waiting frame that no credit limits; 0 for frames with bulk.
std::uint64_t control_bytes(const protocol::Frame& frame) {
    if (frame.header.bulk_bytes != 0) return 0;
    return waiting_frame_bytes + protocol::header_bytes + frame.control.size();
}

/// Time for which a read of so many bytes counts as keeping the io thread: a read that finds its
/// bytes in the transport's buffers comes back without a turn of others.
Clock::duration read_time(std::size_t bytes) {
    return std::chrono::nanoseconds(bytes);
}

/// False for Progress: the daemon sends it by itself, so it does not count as activity of the peer.
bool shows_life(const protocol::Frame& frame) {
    return frame.header.type != static_cast<std::uint16_t>(wire::Message::Progress);
}

/// True for an Error that answers a damaged message.
bool answers_damage(const protocol::Frame& frame) {
    if (frame.header.type != static_cast<std::uint16_t>(wire::Message::Error)) return false;
    const auto code =
        static_cast<Code>(flatbuffers::GetRoot<wire::Error>(frame.control.data())->code());
    return code == Code::bad_frame || code == Code::unknown_type;
}

}  // namespace

void write_last_error(Transport& transport, const protocol::Error& error) {
    std::deque<protocol::Frame> frames;
    frames.push_back(protocol::encode_error(0, error, true));
    WriteBatch batch;
    batch.load(frames);
    transport.write_now(batch.rest());
}

Session::Session(asio::io_context& io, std::unique_ptr<Transport> transport,
                 Connections& connections, const Services& services, const JobContext& context)
    : services_(services),
      connections_(connections),
      io_(io),
      turns_(Turns::of(io)),
      transport_(std::move(transport)),
      wake_(io, never),
      room_(io, never),
      watchdog_(io, never),
      decoder_(services.limits),
      stage_(stage_bytes),
      conversation_(
          services, context, *this, transport_->peer().name,
          [this](const wire::Hello& hello) { return connections_.authenticate(*this, hello); }),
      greeting_deadline_(Clock::now() + milliseconds(services.limits.greeting_ms_max)),
      close_deadline_(never),
      moved_(Clock::now()),
      damage_(damaged_messages_max) {
    decoder_.set_frame_bytes_max(services.limits.greeting_bytes_max);
    conversation_.set_resumed([this] {
        room_.cancel();
        settle();
    });
    decoder_.set_admission(
        [this](const protocol::FrameHeader& header) { return conversation_.admit(header); });
}

void Session::start() {
    spawn(&Session::read_frames, "reader");
    spawn(&Session::write_frames, "writer");
    spawn(&Session::watch, "watchdog");
}

void Session::spawn(Coroutine coroutine, const char* name) {
    asio::co_spawn(io_, (this->*coroutine)(),
                   [self = shared_from_this(), name](const std::exception_ptr& failure) {
                       if (!failure) return;
                       try {
                           std::rethrow_exception(failure);
                       } catch (const std::exception& error) {
                           log_limited(LogLevel::error, "connection_failed", self->principal(),
                                       {{"coroutine", name}, {"reason", error.what()}});
                       }
                       self->stop();
                   });
}

void Session::drain(const std::string& why) {
    if (!open_) return;
    conversation_.drain(why);
    settle();
}

bool Session::close_soon_with_error(const protocol::Error& error) {
    // A peer that does not read would keep its place, and the answers that wait for it.
    if (open_) close_deadline_ = std::min(close_deadline_, Clock::now() + soon);
    return close_with_error(error);
}

bool Session::close_with_error(const protocol::Error& error) {
    if (!open_ || conversation_.closing()) return false;
    conversation_.close_with_error(error);
    wake_.cancel();
    settle();
    return true;
}

void Session::stop() {
    if (!std::exchange(open_, false)) return;
    conversation_.abandon();
    transport_->close();
    wake_.cancel();
    room_.cancel();
    watchdog_.cancel();
    ++services_.metrics.connections_closed;
    connections_.leave(shared_from_this());
}

void Session::drop(Metrics::Counter& counter, const char* why) {
    ++counter;
    const RequestScope scope({number(), 0});
    log_limited(
        LogLevel::info, "dropped", principal(),
        {{"principal", principal()}, {"reason", why}, {"unread", std::to_string(backlog_)}});
    stop();
}

void Session::stop_if_deserted() {
    if (open_ && conversation_.is_held_up() && transport_->has_left()) stop();
}

void Session::stop_if_lost() {
    if (open_ && transport_->is_lost())
        drop(services_.metrics.peers_lost, "its machine or network does not answer");
}

ConnectionRow Session::row() const {
    const auto age = std::chrono::duration_cast<milliseconds>(Clock::now() - accepted_);
    const bool greeted = conversation_.greeted();
    return {number(),
            principal(),
            greeted ? std::string(role_name(identity().role)) : "",
            peer().transport,
            peer().whereabouts(),
            static_cast<std::uint64_t>(age.count()),
            static_cast<std::uint32_t>(conversation_.jobs())};
}

std::uint64_t Session::holds(Resource resource) const {
    switch (resource) {
        case Resource::connections:
            return 1;
        case Resource::jobs:
            return conversation_.in_flight();
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
    // Skip the error if frames wait: it could not follow a partly written frame.
    if (backlog_ == 0) write_last_error(*transport_, why);
    stop();
}

void Session::send(protocol::Frame frame) {
    if (!open_) return;
    // Restart the pause with the first frame of an answer, which may have taken long.
    if (backlog_ == 0 && !reading_ && shows_life(frame)) moved_ = Clock::now();
    if (answers_damage(frame)) damage_.count(Clock::now());
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

bool Session::is_turn(Bandwidth::Direction direction) const {
    const auto next = services_.admission.bandwidth().next(principal(), direction);
    return next == Clock::time_point() || next <= Clock::now();
}

asio::awaitable<void> Session::wait_for_turn(Bandwidth::Direction direction,
                                             asio::steady_timer& timer) {
    while (open_ && !is_turn(direction)) {
        timer.expires_at(services_.admission.bandwidth().next(principal(), direction));
        co_await wait(timer);
    }
    timer.expires_at(never);
}

// ---- reader -------------------------------------------------------------------------------------

asio::awaitable<void> Session::read_frames() {
    SystemError error;
    co_await transport_->open(error);
    if (error && open_ && peer().transport == "tls") ++services_.metrics.handshakes_failed;
    opened_ = true;
    wake_.cancel();
    while (open_ && !error && !conversation_.closing()) {
        // Read no more requests while too many answers are unread.
        while (open_ && crowded()) co_await wait(room_);
        if (!is_turn(Bandwidth::Direction::receive))
            co_await wait_for_turn(Bandwidth::Direction::receive, room_);
        if (!open_) co_return;
        co_await read_some(error);
    }
    if (open_ && !error) co_await linger();
    stop();
}

asio::awaitable<void> Session::read_some(SystemError& error) {
    // Read bulk data directly into place, and the bytes after it in the same call.
    std::span<std::byte> bulk = decoder_.room();
    std::span<std::byte> stage = stage_;
    if (bulk.size() > read_bytes_max) {
        bulk = bulk.first(read_bytes_max);
        stage = {};
    }
    const Transport::ReadBuffers buffers = {asio::buffer(bulk.data(), bulk.size()),
                                            asio::buffer(stage.data(), stage.size())};
    Clock::duration spent{};
    const std::size_t got =
        co_await read_in_turn(buffers, std::max(bulk.size(), std::size_t{1}), spent, error);
    if (error || !open_) co_return;
    co_await take_turn();
    if (!open_) co_return;
    if (got == 0)
        if (const auto unreadable = transport_->take_unreadable())
            conversation_.refuse_unreadable(*unreadable);
    services_.metrics.count<&Metrics::bytes_received>(conversation_.counted_as(), got);
    services_.admission.bandwidth().spend(principal(), Bandwidth::Direction::receive, got,
                                          Clock::now());
    const std::size_t direct = std::min(got, bulk.size());
    decoder_.filled(direct);
    std::span<const std::byte> rest = std::span<const std::byte>(stage).first(got - direct);
    do {
        const Clock::time_point handled = Clock::now();
        reading_ = true;
        rest = take_frames(rest);
        reading_ = false;
        write_at_once();
        settle();
        turns_.spend(principal(), std::exchange(spent, {}) + (Clock::now() - handled));
        co_await take_turn();
        while (open_ && conversation_.is_held_up()) co_await wait(room_);
    } while (open_ && !conversation_.closing() && !rest.empty());
}

asio::awaitable<std::size_t> Session::read_in_turn(const Transport::ReadBuffers& buffers,
                                                   std::size_t wanted, Clock::duration& spent,
                                                   SystemError& error) {
    const bool takes_time = transport_->reads_take_time();
    if (takes_time) co_await take_turn();
    if (!open_) co_return 0;
    transport_->pays(principal());
    const Clock::time_point began = Clock::now();
    const std::size_t got = co_await transport_->read(buffers, wanted, error);
    spent = takes_time && got != 0 ? Clock::now() - began : read_time(got);
    co_return got;
}

asio::awaitable<void> Session::take_turn() {
    if (turns_.is_over(principal())) co_await turns_.wait(principal());
}

std::span<const std::byte> Session::take_frames(std::span<const std::byte> bytes) {
    const Clock::time_point end = Clock::now() + turns_.left(principal());
    bool moved = false;
    do {
        const auto taken = decoder_.feed(bytes);
        if (!taken) {
            conversation_.close_with_error(taken.error());
            return {};
        }
        bytes = bytes.subspan(*taken);
        if (decoder_.complete()) {
            if (!std::exchange(moved, true)) moved_ = Clock::now();
            conversation_.receive(decoder_.take());
            if (greeting_deadline_ != never && conversation_.greeted()) {
                greeting_deadline_ = never;
                decoder_.set_frame_bytes_max(services_.limits.frame_bytes_max);
            }
        }
    } while (open_ && !conversation_.closing() && !conversation_.is_held_up() && !bytes.empty() &&
             Clock::now() < end);
    return bytes;
}

asio::awaitable<void> Session::linger() {
    // Read until the peer closes: closing with unread bytes would reset the connection, and the
    // peer could lose the last frame.
    const Transport::ReadBuffers buffers = {asio::buffer(stage_), asio::mutable_buffer()};
    SystemError error;
    while (open_ && !error) {
        Clock::duration spent{};
        co_await read_in_turn(buffers, 1, spent, error);
        turns_.spend(principal(), spent);
        co_await take_turn();
    }
}

// ---- writer -------------------------------------------------------------------------------------

bool Session::fill_stream() {
    if (batch_.empty() && !outbox_.empty()) batch_.load(outbox_);
    return !batch_.empty();
}

void Session::sent(std::size_t bytes) {
    services_.metrics.count<&Metrics::bytes_sent>(conversation_.counted_as(), bytes);
    services_.admission.bandwidth().spend(principal(), Bandwidth::Direction::send, bytes,
                                          Clock::now());
    backlog_ -= bytes;
    bool moved = false;
    std::uint64_t frames = 0;
    batch_.consume(bytes, [&](const protocol::Frame& frame) {
        ++frames;
        control_backlog_ -= control_bytes(frame);
        moved = moved || shows_life(frame);
    });
    if (frames != 0)
        services_.metrics.count<&Metrics::frames_sent>(conversation_.counted_as(), frames);
    if (moved) moved_ = Clock::now();
}

void Session::write_at_once() {
    if (!open_ || writing_ || !fill_stream()) return;
    if (is_turn(Bandwidth::Direction::send)) sent(transport_->write_now(batch_.rest()));
    if (!batch_.empty() || !outbox_.empty() || conversation_.closing()) wake_.cancel();
    conversation_.runner().pump();
}

asio::awaitable<void> Session::write_frames() {
    while (open_) {
        if (!opened_ || !fill_stream()) {
            if (opened_ && conversation_.closing()) break;
            co_await wait(wake_);
            continue;
        }
        writing_ = true;
        settle();
        if (!is_turn(Bandwidth::Direction::send))
            co_await wait_for_turn(Bandwidth::Direction::send, wake_);
        if (!open_) co_return;
        SystemError error;
        const WriteBatch::Rest rest = batch_.rest();
        const std::size_t bytes = co_await transport_->write(rest, error);
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
    co_await transport_->finish_writing();
    close_deadline_ = Clock::now() + linger_time;
    settle();
}

// ---- watchdog -----------------------------------------------------------------------------------

asio::awaitable<void> Session::watch() {
    while (open_) {
        watchdog_.expires_at(next_deadline());
        co_await wait(watchdog_);
        IoTurn::does("watch");
        if (open_) expire(Clock::now());
    }
}

void Session::settle() {
    if (!open_) return;
    if (damage_.is_over())
        conversation_.close_with_error(
            {Code::bad_frame,
             "more than " + std::to_string(damage_.most()) +
                 " damaged messages came in a minute; mend the client before it connects again",
             0});
    conversation_.settle();
    if (conversation_.closing() && close_deadline_ == never) {
        close_deadline_ = Clock::now() + flush_time;
        room_.cancel();  // nothing is held up any more
    }
    if (next_deadline() < watchdog_.expiry()) watchdog_.cancel();
}

bool Session::crowded() const {
    return backlog_ >= services_.limits.window_bytes ||
           control_backlog_ >= services_.limits.waiting_control_bytes_max;
}

Clock::time_point Session::next_deadline() const {
    if (conversation_.closing()) return close_deadline_;
    return std::min(greeting_deadline_, conversation_.next_deadline());
}

void Session::expire(Clock::time_point now) {
    if (now >= close_deadline_)
        return backlog_ == 0
                   ? stop()
                   : drop(services_.metrics.peers_cut_off, "it did not read the last frames");
    if (conversation_.closing()) return;
    conversation_.runner().tick(now);
    conversation_.expire_parked(now);
    if (now >= greeting_deadline_) {
        ++services_.metrics.timeouts;
        if (!opened_) return stop();
        conversation_.close_with_error({Code::deadline, "no Hello came in time", 0});
    }
    settle();
}

}  // namespace raynest::server
