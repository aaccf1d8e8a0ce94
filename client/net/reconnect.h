// Finds a daemon again that went away.
#pragma once

#include "client/net/connection.h"

#include <functional>
#include <memory>

namespace raynest::client {

using Connect = std::function<Result<std::unique_ptr<Connection>>()>;

/// Tries to connect for `seconds`, and longer while something accepts connections and stays silent,
/// or says that it ends: a service manager holds the socket until the next daemon is up. Fails with
/// `why` if none comes, or with the daemon's refusal.
Result<std::unique_ptr<Connection>> reconnect(const Connect& connect, double seconds,
                                              const Failure& why);

/// True if a first attempt to connect may be followed by others: the daemon says that it ends, or
/// it was killed while its socket, which a service manager holds, lives on. A server that stays
/// silent may be of another kind, and is not waited for.
[[nodiscard]] bool may_connect_again(const Failure& why);

}  // namespace raynest::client
