#include "server/security/user_namespace.h"

#include <cstdint>
#include <fstream>
#include <limits>
#include <sstream>
#include <string>

namespace raynest::server {
namespace {

/// Number of users: all 32-bit numbers but the last, which means none.
constexpr std::uint64_t users = std::numeric_limits<std::uint32_t>::max();
/// The number of unmapped users where the system does not tell another, as under ProcSubset=pid.
constexpr uid_t usual_overflow_user = 65534;

std::string content_of(const char* file) {
    std::ostringstream text;
    text << std::ifstream(file).rdbuf();
    return std::move(text).str();
}

uid_t overflow_user() {
    uid_t user = usual_overflow_user;
    std::istringstream text(content_of("/proc/sys/kernel/overflowuid"));
    if (uid_t told = 0; text >> told) user = told;
    return user;
}

}  // namespace

bool maps_all_users(std::string_view uid_map) {
    std::istringstream rows{std::string(uid_map)};
    std::uint64_t mapped = 0;
    std::uint64_t inside = 0;
    std::uint64_t outside = 0;
    std::uint64_t count = 0;
    while (rows >> inside >> outside >> count) mapped += count;
    return mapped >= users;
}

bool tells_users_apart() {
    static const bool apart = maps_all_users(content_of("/proc/self/uid_map"));
    return apart;
}

bool is_unknown_user(uid_t user) {
    static const uid_t overflow = overflow_user();
    return user == overflow && !tells_users_apart();
}

}  // namespace raynest::server
