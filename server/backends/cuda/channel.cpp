#include "server/backends/cuda/channel.h"

#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

namespace raynest::server::device {
namespace {

constexpr std::size_t files_max = 16;
constexpr std::chrono::milliseconds poll_max = std::chrono::hours(1);

}  // namespace

Result<std::pair<Channel, Channel>> Channel::make_pair() {
    std::array<int, 2> ends{};
    if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends.data()) != 0) {
        return fail(ErrorCode::io_failed, std::string("no socket: ") + std::strerror(errno));
    }
    Fd ours = out_of_the_way(Fd(ends[0]));
    Fd theirs = out_of_the_way(Fd(ends[1]));
    if (ours.get() < 0 || theirs.get() < 0) {
        return fail(ErrorCode::io_failed, std::string("no socket: ") + std::strerror(errno));
    }
    return std::pair(Channel(std::move(ours)), Channel(std::move(theirs)));
}

bool Channel::send_bytes(std::span<const std::byte> bytes, std::span<const int> files) {
    iovec piece{const_cast<std::byte*>(bytes.data()), bytes.size()};
    alignas(cmsghdr) std::array<char, CMSG_SPACE(files_max * sizeof(int))> room{};
    msghdr message{};
    message.msg_iov = &piece;
    message.msg_iovlen = 1;
    if (!files.empty()) {
        message.msg_control = room.data();
        message.msg_controllen = CMSG_SPACE(files.size_bytes());
        auto* const head = reinterpret_cast<cmsghdr*>(room.data());
        head->cmsg_level = SOL_SOCKET;
        head->cmsg_type = SCM_RIGHTS;
        head->cmsg_len = CMSG_LEN(files.size_bytes());
        std::memcpy(CMSG_DATA(head), files.data(), files.size_bytes());
    }
    ssize_t sent = 0;
    do {
        sent = ::sendmsg(get(), &message, MSG_NOSIGNAL);
    } while (sent < 0 && errno == EINTR);
    return sent == static_cast<ssize_t>(bytes.size());
}

Received Channel::receive_bytes(std::span<std::byte> bytes, std::chrono::milliseconds time_limit,
                                std::vector<Fd>* files) {
    using Clock = std::chrono::steady_clock;
    const auto deadline = Clock::now() + time_limit;
    for (;;) {
        pollfd waiting{get(), POLLIN, 0};
        auto left = time_limit;
        if (time_limit >= time_limit.zero()) {
            left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now());
            left = std::max(left, left.zero());
        }
        const auto slice = static_cast<int>(std::min(left, poll_max).count());
        const int ready = ::poll(&waiting, 1, slice);
        if (ready > 0 || (ready < 0 && errno != EINTR)) break;
        if (ready == 0 && left <= poll_max && time_limit >= time_limit.zero())
            return Received::nothing_in_time;
    }
    iovec piece{bytes.data(), bytes.size()};
    alignas(cmsghdr) std::array<char, CMSG_SPACE(files_max * sizeof(int))> room{};
    msghdr message{};
    message.msg_iov = &piece;
    message.msg_iovlen = 1;
    message.msg_control = room.data();
    message.msg_controllen = room.size();
    ssize_t got = 0;
    do {
        got = ::recvmsg(get(), &message, MSG_CMSG_CLOEXEC);
    } while (got < 0 && errno == EINTR);
    for (cmsghdr* head = CMSG_FIRSTHDR(&message); got >= 0 && head != nullptr;
         head = CMSG_NXTHDR(&message, head)) {
        if (head->cmsg_level != SOL_SOCKET || head->cmsg_type != SCM_RIGHTS) continue;
        const std::size_t count = (head->cmsg_len - CMSG_LEN(0)) / sizeof(int);
        for (std::size_t i = 0; i < count; ++i) {
            int file = -1;
            std::memcpy(&file, CMSG_DATA(head) + i * sizeof(int), sizeof file);
            Fd owned(file);
            if (files != nullptr) files->push_back(std::move(owned));
        }
    }
    const bool whole = got == static_cast<ssize_t>(bytes.size()) &&
                       (message.msg_flags & (MSG_TRUNC | MSG_CTRUNC)) == 0;
    return whole ? Received::message : Received::closed;
}

}  // namespace raynest::server::device
