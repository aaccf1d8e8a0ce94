#include "server/net/lost_peer.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <cstdint>

namespace raynest::server {
namespace {

constexpr std::uint32_t silence_ms_max = 20'000;
/// Probes of a full window that nobody answered, in a row.
constexpr int probes_max = 3;

}  // namespace

bool is_lost(int socket) {
    tcp_info info{};
    socklen_t size = sizeof info;
    if (getsockopt(socket, IPPROTO_TCP, TCP_INFO, &info, &size) != 0) return false;
    const std::uint32_t silence_ms = info.tcpi_last_ack_recv;
    if (silence_ms < silence_ms_max) return false;
    // What was sent is sent again after tcpi_rto, which doubles each time, and answered each time.
    if (info.tcpi_unacked != 0) return silence_ms > info.tcpi_rto / 1000 * 3 / 2;
    return info.tcpi_probes >= probes_max;
}

}  // namespace raynest::server
