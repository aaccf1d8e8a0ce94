// Whether the system tells the daemon which users its peers on a Unix socket are.
//
// In a user namespace that does not map every user, as PrivateUsers= of systemd makes, the kernel
// gives one number, usually 65534, for all users without a mapping. Peers of that number would be
// one principal: they would see and unload each other's scenes. The daemon lets them in by a token
// only.
#pragma once

#include <sys/types.h>

#include <string_view>

namespace raynest::server {

/// True if a map in the form of /proc/self/uid_map covers all users.
[[nodiscard]] bool maps_all_users(std::string_view uid_map);

/// True if every user of the system has a number of its own in this process. Thread-safe.
[[nodiscard]] bool tells_users_apart();

/// True if this number may stand for several users.
[[nodiscard]] bool is_unknown_user(uid_t user);

}  // namespace raynest::server
