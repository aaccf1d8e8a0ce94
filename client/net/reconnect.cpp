#include "client/net/reconnect.h"

#include "client/ground/interrupt.h"

#include <chrono>
#include <thread>

namespace raynest::client {
namespace {

using Clock = std::chrono::steady_clock;
using Seconds = std::chrono::duration<double>;

constexpr std::chrono::milliseconds pause{50};
/// Time for the old daemon's jobs to end, which the socket's holder waits for: drain_ms_max.
constexpr Seconds drain_time{30};

}  // namespace

Result<std::unique_ptr<Connection>> reconnect(const Connect& connect, double seconds,
                                              const Failure& why) {
    const Clock::time_point begin = Clock::now();
    while (true) {
        auto connection = connect();
        if (connection) return connection;
        const Failure& refused = connection.error();
        const bool waits = refused.lost || refused.exit == Exit::busy;
        if (!waits && refused.exit != Exit::cannot_connect) return connection;
        const bool drains = refused.lost && (refused.silent || !is_own(refused));
        const Seconds patience = Seconds(seconds) + (drains ? drain_time : Seconds(0));
        if (interrupted()) return fail(Exit::interrupted, "interrupted");
        if (Clock::now() - begin > patience) return tl::unexpected<Failure>(why);
        std::this_thread::sleep_for(pause);
    }
}

bool may_connect_again(const Failure& why) {
    return why.lost && !why.silent;
}

}  // namespace raynest::client
