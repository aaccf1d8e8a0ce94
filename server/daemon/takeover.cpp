#include "server/daemon/takeover.h"

#include "protocol/text.h"
#include "server/daemon/constants.h"
#include "server/ground/log.h"

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <optional>
#include <span>
#include <string_view>
#include <utility>

namespace raynest::server {
namespace {

constexpr const char* socket_name = "successor";
/// The words on the stream; the first names the version of them all.
constexpr std::string_view word_takeover = "takeover 1";
constexpr std::string_view word_serving = "serving";
constexpr std::size_t word_bytes_max = 64;
constexpr std::size_t answer_bytes_max = 64 << 10;
constexpr std::size_t sockets_max = 64;
/// Time for a predecessor to settle; longer than it gives running changes (constants.h).
constexpr std::chrono::seconds answer_time{60};

tl::unexpected<Error> takeover_failed(const std::string& doing, int error = errno) {
    return fail(ErrorCode::io_failed, doing + ": " + std::strerror(error));
}

/// A socket's name in a folder, whose own path may be too long for one.
struct SocketName {
    explicit SocketName(const std::filesystem::path& folder)
        : directory(::open(folder.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC)) {
        const std::string path =
            "/proc/self/fd/" + std::to_string(directory.get()) + "/" + socket_name;
        name.sun_family = AF_UNIX;
        std::copy(path.begin(), path.end(), name.sun_path);
    }
    [[nodiscard]] const sockaddr* address() const {
        return reinterpret_cast<const sockaddr*>(&name);
    }
    Fd directory;
    sockaddr_un name{};
};

Fd make_socket(int flags) {
    return Fd(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | flags, 0));
}

std::optional<ucred> peer_of(int stream) {
    ucred peer{};
    socklen_t size = sizeof peer;
    if (getsockopt(stream, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0) return std::nullopt;
    return peer;
}

bool send_message(int stream, std::string_view text, std::span<const int> descriptors = {}) {
    iovec part{const_cast<char*>(text.data()), text.size()};
    msghdr message{};
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int) * (sockets_max + 1))> control{};
    if (!descriptors.empty()) {
        message.msg_control = control.data();
        message.msg_controllen = CMSG_SPACE(descriptors.size_bytes());
        cmsghdr* const rights = CMSG_FIRSTHDR(&message);
        if (rights == nullptr) return false;
        rights->cmsg_level = SOL_SOCKET;
        rights->cmsg_type = SCM_RIGHTS;
        rights->cmsg_len = CMSG_LEN(descriptors.size_bytes());
        std::memcpy(CMSG_DATA(rights), descriptors.data(), descriptors.size_bytes());
    }
    return ::sendmsg(stream, &message, MSG_NOSIGNAL | MSG_DONTWAIT) ==
           static_cast<ssize_t>(text.size());
}

void send_error(int stream, const std::string& why) {
    (void)send_message(stream, nlohmann::json{{"error", why}}.dump());
}

/// The predecessor's answer.
struct Received {
    std::string text;
    std::vector<Fd> descriptors;
};

Result<Received> receive(int stream) {
    Received received;
    received.text.resize(answer_bytes_max);
    iovec part{received.text.data(), received.text.size()};
    alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int) * (sockets_max + 1))> control{};
    msghdr message{};
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    ssize_t bytes = -1;
    // A daemon that refuses without having read is told first, its words after.
    bool was_reset = false;
    do bytes = ::recvmsg(stream, &message, MSG_CMSG_CLOEXEC);
    while (bytes < 0 &&
           (errno == EINTR || (errno == ECONNRESET && !std::exchange(was_reset, true))));
    const int error = errno;
    for (cmsghdr* part_of = CMSG_FIRSTHDR(&message); bytes >= 0 && part_of != nullptr;
         part_of = CMSG_NXTHDR(&message, part_of)) {
        if (part_of->cmsg_level != SOL_SOCKET || part_of->cmsg_type != SCM_RIGHTS) continue;
        std::vector<int> numbers((part_of->cmsg_len - CMSG_LEN(0)) / sizeof(int));
        std::memcpy(numbers.data(), CMSG_DATA(part_of), numbers.size() * sizeof(int));
        for (const int number : numbers) received.descriptors.emplace_back(number);
    }
    if (bytes < 0) return takeover_failed("the daemon there did not answer", error);
    if (bytes == 0) return fail(ErrorCode::io_failed, "the daemon there ended before it answered");
    if ((message.msg_flags & (MSG_TRUNC | MSG_CTRUNC)) != 0)
        return fail(ErrorCode::io_failed, "the answer of the daemon there was cut");
    received.text.resize(static_cast<std::size_t>(bytes));
    return received;
}

/// Reads what was handed on: the lock, then the sockets. Fails if it is anything else.
Result<std::vector<HandedSocket>> read_sockets(const nlohmann::json& answer,
                                               std::vector<Fd>& descriptors) {
    const auto unreadable = fail(ErrorCode::io_failed,
                                 "the answer of the daemon there is none of this release; stop "
                                 "that daemon, then start this one without --takeover");
    const auto* const rows =
        answer.is_object() && answer.contains("sockets") ? &answer["sockets"] : nullptr;
    if (rows == nullptr || !rows->is_array() || rows->size() + 1 != descriptors.size())
        return unreadable;
    std::vector<HandedSocket> sockets;
    for (std::size_t i = 0; i < rows->size(); ++i) {
        const auto& row = (*rows)[i];
        if (!row.is_object() || !row.contains("value") || !row["value"].is_string() ||
            !row.contains("file") || !row["file"].is_boolean())
            return unreadable;
        HandedSocket socket{row["value"].get<std::string>(), row["file"].get<bool>(),
                            std::move(descriptors[i + 1])};
        if (!address_of(socket.descriptor.get())) return unreadable;
        sockets.push_back(std::move(socket));
    }
    return sockets;
}

}  // namespace

// ---- the predecessor's side ---------------------------------------------------------------------

Result<std::unique_ptr<SuccessorSocket>> SuccessorSocket::open(asio::io_context& io,
                                                               const std::filesystem::path& folder,
                                                               int lock, Acts acts) {
    std::unique_ptr<SuccessorSocket> opened(new SuccessorSocket(io, folder, lock, std::move(acts)));
    if (auto done = opened->listen(); !done) return tl::unexpected(done.error());
    return opened;
}

Result<void> SuccessorSocket::listen() {
    if (listening_.is_open() && has_name()) return {};
    const auto path = folder_ / socket_name;
    const SocketName name(folder_);
    Fd made = make_socket(SOCK_NONBLOCK);
    // The lock is ours: one that is there belongs to a daemon that was killed, or gives way, or to a
    // successor that has ended.
    (void)::unlink(path.c_str());
    struct stat found {};
    if (made.get() < 0 || ::fchmod(made.get(), S_IRUSR | S_IWUSR) != 0 ||
        ::bind(made.get(), name.address(), sizeof name.name) != 0 || ::listen(made.get(), 4) != 0 ||
        ::lstat(path.c_str(), &found) != 0)
        return takeover_failed("cannot listen on " + path.string());
    inode_ = found.st_ino;
    if (listening_.is_open()) listening_.close();
    listening_.assign(::fcntl(made.get(), F_DUPFD_CLOEXEC, 0));
    await_peer();
    return {};
}

bool SuccessorSocket::has_name() const {
    struct stat found {};
    return ::lstat((folder_ / socket_name).c_str(), &found) == 0 && found.st_ino == inode_;
}

SuccessorSocket::~SuccessorSocket() {
    // A successor has put the name of its own socket there.
    if (inode_ != 0 && has_name()) (void)::unlink((folder_ / socket_name).c_str());
}

void SuccessorSocket::await_peer() {
    listening_.async_wait(listening_.wait_read, [this](const SystemError& error) {
        if (error) return;
        // The next one waits until changes go on.
        if (phase_ == Phase::returning) {
            peer_waits_ = true;
            return;
        }
        accept();
        if (phase_ != Phase::gone) await_peer();
    });
}

void SuccessorSocket::accept() {
    Fd stream(
        ::accept4(listening_.native_handle(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (stream.get() < 0) return;
    const auto peer = peer_of(stream.get());
    if (!peer || peer->uid != geteuid())
        return send_error(stream.get(), "the daemon there runs as the user with the number " +
                                            std::to_string(geteuid()) +
                                            "; start its successor as that user");
    if (phase_ != Phase::alone && phase_ != Phase::greeting)
        return send_error(stream.get(), "another raynestd takes its place already");
    // One that has not said anything holds up nobody.
    if (peer_.is_open()) peer_.close();
    peer_.assign(::fcntl(stream.get(), F_DUPFD_CLOEXEC, 0));
    pid_ = peer->pid;
    process_ = Fd(static_cast<int>(::syscall(SYS_pidfd_open, pid_, 0)));
    phase_ = Phase::greeting;
    await_word();
}

void SuccessorSocket::await_word() {
    peer_.async_wait(peer_.wait_read, [this](const SystemError& error) {
        if (!error) hear();
    });
}

void SuccessorSocket::hear() {
    std::array<char, word_bytes_max> bytes{};
    const ssize_t size = ::recv(peer_.native_handle(), bytes.data(), bytes.size(), MSG_DONTWAIT);
    if (size < 0 && (errno == EAGAIN || errno == EINTR)) return await_word();
    if (size <= 0) return lose_peer();
    const std::string_view word(bytes.data(), static_cast<std::size_t>(size));
    if (phase_ == Phase::handed && word == word_serving) {
        phase_ = Phase::gone;
        timer_.cancel();
        listening_.close();
        // The stream ends with this process: the successor waits for that.
        return acts_.give_way(pid_);
    }
    if (phase_ != Phase::greeting || word != word_takeover) {
        send_error(peer_.native_handle(),
                   "the daemon there is of another release; stop it, then start this one without "
                   "--takeover");
        return lose_peer();
    }
    phase_ = Phase::settling;
    log(LogLevel::info, "takeover_asked", {{"pid", std::to_string(pid_)}});
    acts_.settle([this] { settled(); });
    await_word();
}

void SuccessorSocket::settled() {
    if (phase_ == Phase::deserted) return return_to_work();
    phase_ = Phase::handed;
    timer_.expires_after(serve_time);
    timer_.async_wait([this](const SystemError& error) {
        if (!error && phase_ == Phase::handed) end_peer();
    });
    std::vector<int> descriptors = {lock_};
    nlohmann::json rows = nlohmann::json::array();
    const std::vector<HandedSocket> sockets = acts_.sockets();
    for (const HandedSocket& socket : sockets) {
        descriptors.push_back(socket.descriptor.get());
        rows.push_back({{"value", socket.value}, {"file", socket.has_file}});
    }
    const std::string text = nlohmann::json{{"sockets", rows}}.dump();
    if (sockets.size() <= sockets_max && text.size() <= answer_bytes_max &&
        send_message(peer_.native_handle(), text, descriptors))
        return;
    send_error(peer_.native_handle(), "the daemon there cannot hand its sockets over");
    lose_peer();
}

void SuccessorSocket::lose_peer() {
    peer_.close();
    if (phase_ == Phase::settling) {
        phase_ = Phase::deserted;
        return;
    }
    timer_.cancel();
    if (phase_ == Phase::handed) return return_to_work();
    phase_ = Phase::alone;
}

void SuccessorSocket::return_to_work() {
    phase_ = Phase::returning;
    if (const auto done = listen(); !done)
        log(LogLevel::error, "no_takeover", {{"reason", done.error().message}});
    acts_.go_on([this] {
        phase_ = Phase::alone;
        if (std::exchange(peer_waits_, false)) await_peer();
    });
}

void SuccessorSocket::end_peer() const {
    log(LogLevel::warn, "successor_ended",
        {{"pid", std::to_string(pid_)},
         {"reason", "it has not served within " + std::to_string(serve_time.count()) + " s"}});
    // Its end of the stream closes with it. A kernel before 5.3 knows no descriptors of processes.
    if (process_.get() < 0 ||
        ::syscall(SYS_pidfd_send_signal, process_.get(), SIGKILL, nullptr, 0) != 0)
        (void)::kill(pid_, SIGKILL);
}

// ---- the successor's side -----------------------------------------------------------------------

Result<Predecessor> Predecessor::ask(const std::filesystem::path& folder) {
    const std::string doing = "cannot take " + folder.string() + " over: ";
    const auto not_taken = [&](const Error& why) {
        return fail(ErrorCode::io_failed, doing + why.message);
    };
    Predecessor before;
    const SocketName name(folder);
    before.stream_ = make_socket(0);
    if (::connect(before.stream_.get(), name.address(), sizeof name.name) != 0)
        return fail(ErrorCode::io_failed, doing + "the daemon there cannot be asked (" +
                                              std::strerror(errno) +
                                              "); stop it, then start this one without --takeover");
    const auto peer = peer_of(before.stream_.get());
    if (!peer || (peer->uid != geteuid() && peer->uid != 0))
        return fail(ErrorCode::io_failed, doing + "another user listens there");
    before.pid_ = peer->pid;
    // One that refuses at once may have closed its end; its answer tells why.
    (void)send_message(before.stream_.get(), word_takeover);
    pollfd wait{before.stream_.get(), POLLIN, 0};
    int ready = -1;
    do ready = ::poll(&wait, 1, static_cast<int>(std::chrono::milliseconds(answer_time).count()));
    while (ready < 0 && errno == EINTR);
    if (ready != 1)
        return fail(ErrorCode::io_failed,
                    doing + "the daemon there, process " + std::to_string(before.pid_) +
                        ", does not answer; stop it, then start this one without --takeover");
    auto received = receive(before.stream_.get());
    if (!received) return not_taken(received.error());
    const auto answer = nlohmann::json::parse(received->text, nullptr, false);
    if (answer.is_object() && answer.contains("error") && answer["error"].is_string())
        return fail(ErrorCode::io_failed,
                    doing + protocol::clean_text(answer["error"].get<std::string>(), 1024));
    auto sockets = read_sockets(answer, received->descriptors);
    if (!sockets) return not_taken(sockets.error());
    before.lock_ = StateLock::adopt(std::move(received->descriptors.front()));
    before.sockets_ = std::move(*sockets);
    return before;
}

void Predecessor::serving() const {
    (void)send_message(stream_.get(), word_serving);
}

}  // namespace raynest::server
