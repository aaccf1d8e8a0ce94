// Roles of principals, as listed in protocol/lists/roles.def.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>
#include <string_view>

namespace raynest::server {

/// Each role may do what the roles before it may.
enum class Role {
#define RAYNEST_ROLE(name, text) name,
#include "protocol/lists/roles.def"
};

inline constexpr std::array role_names = {
#define RAYNEST_ROLE(name, text) std::string_view(#name),
#include "protocol/lists/roles.def"
};

[[nodiscard]] constexpr std::string_view role_name(Role role) {
    return role_names[static_cast<std::size_t>(role)];
}

/// Returns nothing for a word that is no role.
[[nodiscard]] constexpr std::optional<Role> parse_role(std::string_view word) {
    const auto* found = std::find(role_names.begin(), role_names.end(), word);
    if (found == role_names.end()) return std::nullopt;
    return static_cast<Role>(found - role_names.begin());
}

}  // namespace raynest::server
