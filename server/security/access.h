// Access rules: every NOT_ALLOWED error that a client receives comes from these functions. They
// decide by their arguments alone; callers look the facts up.
#pragma once

#include "server/ground/errors.h"
#include "server/security/role.h"

#include <string_view>

namespace raynest::server {
struct ConnectionId;
}

namespace raynest::server::access {

/// Allows callers whose role is at least the one of the request table.
[[nodiscard]] Reply<void> send_request(std::string_view request, Role needed, Role callers);

/// Allows the principal that started the job, on any connection, and administrators. For others
/// there is no such job.
[[nodiscard]] bool may_use_job(std::string_view owner, const ConnectionId& caller);

/// Allows owners, holders and administrators. Ask only about a scene that the caller may see.
[[nodiscard]] Reply<void> unload_scene(std::string_view name, std::string_view owner,
                                       bool is_callers);

/// Allows owners and administrators. Ask only about a scene that the caller may see.
[[nodiscard]] Reply<void> edit_scene(std::string_view name, std::string_view owner,
                                     const ConnectionId& caller);

}  // namespace raynest::server::access
