#include "server/security/access.h"

#include "server/security/caller.h"

#include <string>

namespace raynest::server::access {
namespace {

Reply<void> allow(bool allowed, std::string_view what, std::string_view why_not) {
    if (allowed) return {};
    return refuse(Code::not_allowed, std::string(what).append(" ").append(why_not));
}

std::string scene(std::string_view name) {
    return "scene '" + std::string(name) + "'";
}

}  // namespace

Reply<void> send_request(std::string_view request, Role needed, Role callers) {
    return allow(callers >= needed, request,
                 "needs the role " + std::string(role_name(needed)) + ", and yours is " +
                     std::string(role_name(callers)) + "; ask the daemon's administrator");
}

bool may_use_job(std::string_view owner, const ConnectionId& caller) {
    return owner == caller.principal || caller.role == Role::admin;
}

Reply<void> unload_scene(std::string_view name, std::string_view owner, bool is_callers) {
    return allow(is_callers, scene(name),
                 "belongs to " + std::string(owner) + "; only its owner may unload it");
}

Reply<void> edit_scene(std::string_view name, std::string_view owner, const ConnectionId& caller) {
    return allow(owner == caller.principal || caller.role == Role::admin, scene(name),
                 "belongs to " + std::string(owner) + "; only its owner may edit it");
}

}  // namespace raynest::server::access
