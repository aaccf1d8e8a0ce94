#include "server/net/principal.h"

#include <sys/socket.h>

#include <algorithm>

namespace raynest::server {

std::string principal_of(Socket& socket) {
    ucred peer{};
    socklen_t size = sizeof peer;
    sockaddr_storage address{};
    socklen_t address_size = sizeof address;
    auto* generic = reinterpret_cast<sockaddr*>(&address);
    if (getsockname(socket.native_handle(), generic, &address_size) == 0 &&
        address.ss_family == AF_UNIX &&
        getsockopt(socket.native_handle(), SOL_SOCKET, SO_PEERCRED, &peer, &size) == 0)
        return "uid:" + std::to_string(peer.uid);
    SystemError error;
    const auto endpoint = socket.remote_endpoint(error);
    if (error) return "unknown";
    asio::ip::tcp::endpoint tcp;
    if (endpoint.size() > tcp.capacity()) return "unknown";
    std::copy_n(reinterpret_cast<const char*>(endpoint.data()), endpoint.size(),
                reinterpret_cast<char*>(tcp.data()));
    return tcp.address().is_loopback() ? "127.0.0.1" : tcp.address().to_string();
}

}  // namespace raynest::server
