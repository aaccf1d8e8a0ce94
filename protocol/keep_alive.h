// How both ends find out that the other's machine or network is gone: TCP asks it, and a peer that
// lives answers, however long it pauses. TCP_USER_TIMEOUT would end that one, too.
#pragma once

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

namespace raynest::protocol {

/// Asks after so many seconds of silence, then so often, so many times: 17 s in all.
inline constexpr int keep_alive_idle_s = 8;
inline constexpr int keep_alive_interval_s = 3;
inline constexpr int keep_alive_probes = 3;

/// Small frames leave at once, and a dead peer is noticed. Unix sockets know none of these options:
/// failures do not matter.
inline void tune_tcp(int socket) {
    const auto set = [&](int level, int name, int value) {
        (void)setsockopt(socket, level, name, &value, sizeof value);
    };
    set(IPPROTO_TCP, TCP_NODELAY, 1);
    set(SOL_SOCKET, SO_KEEPALIVE, 1);
    set(IPPROTO_TCP, TCP_KEEPIDLE, keep_alive_idle_s);
    set(IPPROTO_TCP, TCP_KEEPINTVL, keep_alive_interval_s);
    set(IPPROTO_TCP, TCP_KEEPCNT, keep_alive_probes);
}

}  // namespace raynest::protocol
