#include "server/access.h"

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

Reply<void> use_job(std::uint64_t number, std::string_view owner, std::string_view principal) {
    return allow(owner == principal, "job " + std::to_string(number),
                 "belongs to " + std::string(owner) +
                     "; only its owner may wait for it, fetch it or cancel it");
}

Reply<void> unload_scene(std::string_view name, std::string_view owner, bool is_callers) {
    return allow(is_callers, scene(name),
                 "belongs to " + std::string(owner) + "; only its owner may unload it");
}

Reply<void> replace_scene(std::string_view name, bool is_only_callers) {
    return allow(is_only_callers, scene(name),
                 "is held by others too; give this one another `name`");
}

}  // namespace raynest::server::access
