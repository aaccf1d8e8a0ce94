#include "tests/bench/load_test/driver.h"

#include "client/ground/interrupt.h"
#include "protocol/control.h"

#include <poll.h>
#include <sys/epoll.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <string>

namespace raynest::client {
namespace {

constexpr std::size_t staging_bytes = 256 << 10;
constexpr std::chrono::seconds patience{10};
/// Longest wait between two checks for Ctrl-C.
constexpr std::chrono::milliseconds nap_max{200};

tl::unexpected<Failure> broken(const char* call) {
    return fail(Exit::failed,
                std::string("a connection broke: ") + call + ": " + std::strerror(errno));
}

const protocol::Limits limits;

bool is_end(const protocol::Frame& frame) {
    return frame.header.type == static_cast<std::uint16_t>(wire::Message::Done) ||
           frame.header.type == static_cast<std::uint16_t>(wire::Message::Error);
}

}  // namespace

Driver::Client::Client(int number, std::span<const std::byte> bytes)
    : socket(number),
      request(bytes),
      decoder(limits) {
    // Skip the columns of answers; only their ends matter.
    decoder.set_admission([](const protocol::FrameHeader&) { return false; });
}

Driver::Driver(std::vector<int> sockets, std::vector<std::span<const std::byte>> requests)
    : events_(epoll_create1(EPOLL_CLOEXEC)),
      staging_(staging_bytes) {
    clients_.reserve(sockets.size());
    for (std::size_t i = 0; i < sockets.size(); ++i) {
        Client& client = clients_.emplace_back(sockets[i], requests[i]);
        client.phase = static_cast<double>(i) / static_cast<double>(sockets.size());
        epoll_event event{};
        event.events = EPOLLIN;
        event.data.u64 = i;
        (void)epoll_ctl(events_.number(), EPOLL_CTL_ADD, client.socket, &event);
    }
}

Result<void> Driver::run(std::chrono::nanoseconds time, double rate,
                         LoadTestStatistics& statistics) {
    const Clock::time_point begin = Clock::now();
    end_ = begin + time;
    interval_ = Clock::duration(0);
    if (rate > 0)
        interval_ = std::chrono::duration_cast<Clock::duration>(
            std::chrono::duration<double>(static_cast<double>(clients_.size()) / rate));
    cut_ = open_loop() ? end_ + overtime_ : end_;

    unfinished_ = clients_.size();
    for (Client& client : clients_) {
        client.due = begin + std::chrono::duration_cast<Clock::duration>(client.phase * interval_);
        client.finished = false;
        if (client.due >= end_) finish(client);
    }
    // An open loop lasts as long as its schedule, even if nothing more is due.
    for (Clock::time_point now = begin; unfinished_ != 0 || (open_loop() && now < end_);
         now = Clock::now()) {
        if (interrupted()) return fail(Exit::interrupted, "interrupted");
        if (now > cut_ + patience)
            return fail(Exit::failed,
                        "an answer did not come within " + std::to_string(patience.count()) + " s");
        if (open_loop() && now >= cut_)
            give_up(now, statistics);
        else if (auto started = start_due(now, statistics); !started)
            return started;
        if (auto taken = take_events(now, statistics); !taken) return taken;
    }
    statistics.time += Clock::now() - begin;
    return {};
}

Result<void> Driver::start_due(Clock::time_point now, LoadTestStatistics& statistics) {
    for (Client& client : clients_)
        if (!client.waiting && !client.finished && client.due <= now)
            if (auto started = start(client, statistics); !started) return started;
    return {};
}

void Driver::finish(Client& client) {
    client.finished = true;
    --unfinished_;
    if (!open_loop()) return;
    const std::chrono::duration<double> ahead = client.due - end_;
    client.phase = std::fmod(ahead / std::chrono::duration<double>(interval_), 1.0);
}

void Driver::give_up(Clock::time_point now, LoadTestStatistics& statistics) {
    bool late = false;
    for (Client& client : clients_) {
        if (client.waiting || client.finished) continue;
        for (; client.due < end_; client.due += interval_) {
            ++statistics.missed;
            statistics.latencies.add(now - client.due);
            late = true;
        }
        finish(client);
    }
    // A server that could not keep up will not do so in the next turn either.
    if (late) overtime_ /= 2;
}

Result<void> Driver::start(Client& client, LoadTestStatistics& statistics) {
    client.waiting = true;
    client.unsent = client.request.size();
    statistics.bytes += client.request.size();
    return send_rest(client);
}

Result<void> Driver::send_rest(Client& client) {
    const bool was_stuck = client.unsent != client.request.size();
    while (client.unsent != 0) {
        const std::span<const std::byte> rest = client.request.last(client.unsent);
        const ssize_t sent =
            send(client.socket, rest.data(), rest.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
        if (sent < 0 && (errno == EAGAIN || errno == EINTR)) break;
        if (sent < 0) return broken("send");
        client.unsent -= static_cast<std::size_t>(sent);
    }
    // Wait for room in the socket, which costs a call, only if a request was not sent at once.
    if (client.unsent != 0 || was_stuck) {
        epoll_event event{};
        event.events = client.unsent != 0 ? EPOLLIN | EPOLLOUT : EPOLLIN;
        event.data.u64 = static_cast<std::uint64_t>(&client - clients_.data());
        (void)epoll_ctl(events_.number(), EPOLL_CTL_MOD, client.socket, &event);
    }
    return {};
}

Result<void> Driver::take_events(Clock::time_point now, LoadTestStatistics& statistics) {
    // In an open loop the next request may be due before an answer comes.
    Clock::time_point until = now + nap_max;
    if (open_loop() && now < end_) until = std::min(until, end_);
    if (open_loop())
        for (const Client& client : clients_)
            if (!client.waiting && !client.finished) until = std::min(until, client.due);
    const auto nap = std::clamp<Clock::duration>(until - now, Clock::duration(0), nap_max);
    const std::timespec timeout{0, std::chrono::nanoseconds(nap).count()};
    pollfd ready{events_.number(), POLLIN, 0};
    if (ppoll(&ready, 1, &timeout, nullptr) <= 0) return {};

    std::array<epoll_event, 64> events{};
    const int count =
        epoll_wait(events_.number(), events.data(), static_cast<int>(events.size()), 0);
    for (int i = 0; i < count; ++i) {
        const epoll_event& event = events[static_cast<std::size_t>(i)];
        Client& client = clients_[event.data.u64];
        if ((event.events & EPOLLOUT) != 0)
            if (auto sent = send_rest(client); !sent) return sent;
        if ((event.events & ~static_cast<std::uint32_t>(EPOLLOUT)) != 0)
            if (auto received = receive(client, statistics); !received) return received;
    }
    return {};
}

Result<void> Driver::receive(Client& client, LoadTestStatistics& statistics) {
    const ssize_t got = recv(client.socket, staging_.data(), staging_.size(), MSG_DONTWAIT);
    if (got < 0 && (errno == EAGAIN || errno == EINTR)) return {};
    if (got < 0) return broken("recv");
    if (got == 0) return fail(Exit::failed, "the daemon closed a connection");
    std::span<const std::byte> bytes(staging_.data(), static_cast<std::size_t>(got));
    statistics.bytes += bytes.size();
    if (sample_.empty()) client.answer.insert(client.answer.end(), bytes.begin(), bytes.end());
    while (!bytes.empty()) {
        const auto taken = client.decoder.feed(bytes);
        if (!taken) return daemon_sent("a broken frame: " + taken.error().message);
        bytes = bytes.subspan(*taken);
        if (!client.decoder.complete()) continue;
        const protocol::Frame frame = client.decoder.take();
        if (!client.waiting || !is_end(frame)) continue;
        const Clock::time_point now = Clock::now();
        ended(client, frame, now, statistics);
        if (!client.finished && client.due <= now && now < cut_)
            if (auto started = start(client, statistics); !started) return started;
    }
    return {};
}

void Driver::ended(Client& client, const protocol::Frame& last, Clock::time_point now,
                   LoadTestStatistics& statistics) {
    client.waiting = false;
    if (const auto error = protocol::open<wire::Error>(last)) {
        ++statistics.refused;
        statistics.refusal =
            failure({static_cast<protocol::Code>((*error)->code()),
                     std::string(protocol::text((*error)->message())), (*error)->retry_after_ms()});
    } else {
        statistics.latencies.add(now - client.due);
        if (sample_.empty()) sample_.swap(client.answer);
    }
    client.answer.clear();
    client.due = open_loop() ? client.due + interval_ : now;
    if (client.due >= end_) finish(client);
}

}  // namespace raynest::client
