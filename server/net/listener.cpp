#include "server/net/listener.h"

#include "server/ground/limited_log.h"
#include "server/ground/log.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <new>
#include <variant>

namespace raynest::server {
namespace {

using std::chrono::milliseconds;

/// A burst of newcomers beyond it waits a second, for their systems' next try.
constexpr int backlog = SOMAXCONN;
/// Pause after a failed accept, e.g. without file descriptors; it doubles from `min` to `max`.
constexpr milliseconds backoff_min{10};
constexpr milliseconds backoff_max{1000};
constexpr std::chrono::seconds log_period{1};

bool used_up(const SystemError& error) {
    return error == boost::system::errc::too_many_files_open ||
           error == boost::system::errc::too_many_files_open_in_system;
}

Fd open_spare() {
    return Fd(::open("/dev/null", O_RDONLY | O_CLOEXEC));
}

/// An address to listen on, and the option that says so.
struct Place {
    const Address& address;
    std::string_view option;
};

/// A listening socket that Asio does not own yet.
struct Bound {
    int descriptor = -1;
    int family = 0;
    Address address;
};

tl::unexpected<Error> refused(const Place& place, const std::string& why) {
    const bool tcp = std::holds_alternative<TcpAddress>(place.address);
    return fail(ErrorCode::io_failed, "cannot listen on " + to_uri(place.address) + ": " + why +
                                          "; give " + std::string(place.option) + " another " +
                                          (tcp ? "port, 0 picks a free one" : "path"));
}

tl::unexpected<Error> failed(const Place& place, const char* call) {
    return refused(place, std::string(call) + ": " + std::strerror(errno));
}

Result<int> make_socket(const Place& place, int family) {
    const int descriptor = socket(family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (descriptor < 0) return failed(place, "socket");
    return descriptor;
}

/// Binds, calls `prepare`, then listens; no client can connect before that. `prepare` returns null,
/// or the name of the call that failed.
template <class Prepare>
Result<Bound> finish(int descriptor, int family, const Place& place, const sockaddr* name,
                     socklen_t size, Prepare prepare) {
    const char* call = bind(descriptor, name, size) == 0 ? prepare() : "bind";
    if (call == nullptr && listen(descriptor, backlog) != 0) call = "listen";
    if (call == nullptr) return Bound{descriptor, family, place.address};
    const auto error = failed(place, call);
    close(descriptor);
    return error;
}

Result<Bound> bind_tcp(const Place& place) {
    TcpAddress address = std::get<TcpAddress>(place.address);
    sockaddr_in v4{};
    sockaddr_in6 v6{};
    v4.sin_family = AF_INET;
    v4.sin_port = htons(address.port);
    v6.sin6_family = AF_INET6;
    v6.sin6_port = htons(address.port);
    const bool is_v4 = inet_pton(AF_INET, address.host.c_str(), &v4.sin_addr) == 1;
    if (!is_v4) inet_pton(AF_INET6, address.host.c_str(), &v6.sin6_addr);
    auto* name = is_v4 ? reinterpret_cast<sockaddr*>(&v4) : reinterpret_cast<sockaddr*>(&v6);
    socklen_t size = is_v4 ? sizeof v4 : sizeof v6;
    const int family = name->sa_family;

    const auto descriptor = make_socket(place, family);
    if (!descriptor) return tl::unexpected(descriptor.error());
    const int reuse = 1;
    (void)setsockopt(*descriptor, SOL_SOCKET, SO_REUSEADDR, &reuse, sizeof reuse);
    auto bound =
        finish(*descriptor, family, place, name, size, []() -> const char* { return nullptr; });
    if (!bound) return bound;
    getsockname(*descriptor, name, &size);
    address.port = ntohs(is_v4 ? v4.sin_port : v6.sin6_port);
    bound->address = address;
    return bound;
}

/// Removes the socket of a dead daemon. Fails if a daemon listens on it, or if it is not a socket.
Result<void> clear_path(const Place& place, const sockaddr_un& name) {
    const char* path = std::get<UnixAddress>(place.address).path.c_str();
    struct stat status {};
    if (lstat(path, &status) != 0) return {};
    if (!S_ISSOCK(status.st_mode)) return refused(place, "something that is no socket is there");
    const auto probe = make_socket(place, AF_UNIX);
    if (!probe) return tl::unexpected(probe.error());
    const int answer = connect(*probe, reinterpret_cast<const sockaddr*>(&name), sizeof name);
    const int why = answer == 0 ? 0 : errno;
    close(*probe);
    // EAGAIN means a full backlog, so a daemon listens there.
    if (why == 0 || why == EAGAIN) return refused(place, "another daemon listens there");
    if (why != ECONNREFUSED) return refused(place, std::string("connect: ") + std::strerror(why));
    if (unlink(path) != 0) return failed(place, "unlink");
    return {};
}

/// Gives a socket's file its group, then the mode that gives the group access.
/// Returns what failed, with errno. Opens the file once: where others may rename files, its path
/// may lead elsewhere by now.
const char* set_access(const char* path, const SocketAccess& access) {
    const Fd file(::open(path, O_PATH | O_NOFOLLOW | O_CLOEXEC));
    struct stat status {};
    if (file.get() < 0 || fstat(file.get(), &status) != 0) return "open";
    errno = EEXIST;
    if (!S_ISSOCK(status.st_mode)) return "open";
    if (access.group &&
        fchownat(file.get(), "", static_cast<uid_t>(-1), *access.group, AT_EMPTY_PATH) != 0)
        return "chown to --socket-group";
    // fchmod() refuses a descriptor of O_PATH.
    const std::string opened = "/proc/self/fd/" + std::to_string(file.get());
    return chmod(opened.c_str(), access.mode) == 0 ? nullptr : "chmod to --socket-mode";
}

Result<Bound> bind_unix(const Place& place, const SocketAccess& access) {
    const auto& address = std::get<UnixAddress>(place.address);
    sockaddr_un name{};
    name.sun_family = AF_UNIX;
    std::copy(address.path.begin(), address.path.end(), name.sun_path);
    if (const auto clear = clear_path(place, name); !clear) return tl::unexpected(clear.error());
    const auto descriptor = make_socket(place, AF_UNIX);
    if (!descriptor) return tl::unexpected(descriptor.error());
    // Widen access last: bind() creates the file with at most the socket's mode, 0600.
    const auto prepare = [&] { return set_access(address.path.c_str(), access); };
    if (fchmod(*descriptor, 0600) != 0) {
        close(*descriptor);
        return failed(place, "fchmod");
    }
    return finish(*descriptor, AF_UNIX, place, reinterpret_cast<const sockaddr*>(&name),
                  sizeof name, prepare);
}

/// Takes over a socket that another process has opened and that listens already.
Result<Bound> adopt(const Place& place, int family, int descriptor) {
    const int flags = fcntl(descriptor, F_GETFL);
    if (flags < 0 || fcntl(descriptor, F_SETFL, flags | O_NONBLOCK) != 0 ||
        fcntl(descriptor, F_SETFD, FD_CLOEXEC) != 0)
        return failed(place, "fcntl");
    return Bound{descriptor, family, place.address};
}

Result<Bound> bind_to(const Place& place, const SocketAccess& access) {
    if (const auto* local = std::get_if<UnixAddress>(&place.address))
        return local->descriptor >= 0 ? adopt(place, AF_UNIX, local->descriptor)
                                      : bind_unix(place, access);
    const auto& tcp = std::get<TcpAddress>(place.address);
    const int family = tcp.host.find(':') == std::string::npos ? AF_INET : AF_INET6;
    return tcp.descriptor >= 0 ? adopt(place, family, tcp.descriptor) : bind_tcp(place);
}

}  // namespace

Result<std::unique_ptr<Listener>> Listener::open(asio::io_context& io, const Address& address,
                                                 std::string_view option,
                                                 const SocketAccess& access, Accept accept) {
    const Place place{address, option};
    const auto* unix_address = std::get_if<UnixAddress>(&address);
    const auto bound = bind_to(place, access);
    if (!bound) return tl::unexpected(bound.error());
    std::unique_ptr<Listener> listener(new Listener(io, std::move(accept)));
    listener->acceptor_.assign({bound->family, 0}, bound->descriptor);
    listener->acceptor_.non_blocking(true);
    listener->address_ = bound->address;
    if (unix_address != nullptr && unix_address->descriptor < 0)
        listener->socket_file_ = unix_address->path;
    return listener;
}

void Listener::close() {
    SystemError ignored;
    acceptor_.close(ignored);
    pause_.cancel();
    if (!socket_file_.empty()) unlink(socket_file_.c_str());
    socket_file_.clear();
}

Result<void> Listener::take_file(const SocketAccess& access) {
    const auto* local = std::get_if<UnixAddress>(&address_);
    if (local == nullptr || !local->has_file) return {};
    socket_file_ = local->path;
    if (const char* call = set_access(socket_file_.c_str(), access))
        return fail(ErrorCode::io_failed, std::string(call) + ": " + std::strerror(errno));
    return {};
}

void Listener::hand_on(Socket socket, Descriptors descriptors) {
    try {
        accept_(std::move(socket), descriptors);
    } catch (const std::bad_alloc&) {
        log_limited(LogLevel::error, "accept_failed", "",
                    {{"listen", uri()}, {"reason", "out of memory"}});
    }
}

void Listener::accept_next() {
    if (spare_.get() < 0) spare_ = open_spare();
    acceptor_.async_accept(
        [this](const SystemError& error, Socket socket) { accepted(error, std::move(socket)); });
}

void Listener::accepted(const SystemError& error, Socket socket) {
    if (!acceptor_.is_open()) return;
    if (!error) {
        backoff_ = milliseconds(0);
        const Descriptors left = left_at(socket.native_handle());
        if (left != Descriptors::free) log_shortage();
        hand_on(std::move(socket), left);
        return accept_next();
    }
    if (!used_up(error) || spare_.get() < 0) return accept_later(error);
    // Wait for a peer: accept() fails without a descriptor even if no peer waits.
    acceptor_.async_wait(acceptor_.wait_read, [this](const SystemError& cancelled) {
        if (cancelled || !acceptor_.is_open()) return;
        const SystemError failed = accept_newcomer();
        if (!failed || failed == asio::error::would_block) return accept_next();
        accept_later(failed);
    });
}

void Listener::log_shortage() {
    const auto now = Clock::now();
    if (now - told_ < log_period) return;
    told_ = now;
    log(LogLevel::warn, "descriptors_used_up", {{"listen", uri()}});
}

SystemError Listener::accept_newcomer() {
    SystemError error;
    Socket socket = acceptor_.accept(error);
    if (!used_up(error)) {
        if (!error) hand_on(std::move(socket), left_at(socket.native_handle()));
        return error;
    }
    log_shortage();
    spare_ = Fd();
    socket = acceptor_.accept(error);
    if (!error) hand_on(std::move(socket), Descriptors::used_up);
    spare_ = open_spare();
    return error;
}

void Listener::accept_later(const SystemError& error) {
    // Pause before the next try: descriptors or memory are short, and a busy loop makes it worse.
    backoff_ = std::clamp(2 * backoff_, backoff_min, backoff_max);
    if (backoff_ == backoff_max)
        log(LogLevel::warn, "accept_failed", {{"listen", uri()}, {"reason", error.message()}});
    pause_.expires_after(backoff_);
    pause_.async_wait([this](const SystemError& cancelled) {
        if (!cancelled) accept_next();
    });
}

}  // namespace raynest::server
