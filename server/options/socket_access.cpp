#include "server/options/socket_access.h"

#include <grp.h>
#include <sys/types.h>

#include <array>
#include <charconv>

namespace raynest::server {

std::optional<unsigned> to_mode(const std::string& text) {
    unsigned mode = 0;
    const char* last = text.data() + text.size();
    const auto [end, error] = std::from_chars(text.data(), last, mode, 8);
    if (error != std::errc{} || end != last || mode > 0777 || (mode & 0600U) != 0600)
        return std::nullopt;
    return mode;
}

std::string mode_fault(const std::string& text) {
    return to_mode(text) ? "" : "'" + text + "' is not a mode of 0600 to 0777, such as 0660";
}

std::optional<unsigned> to_group(const std::string& text) {
    unsigned number = 0;
    const char* last = text.data() + text.size();
    const auto [end, error] = std::from_chars(text.data(), last, number);
    // Reject -1: chown() would keep the group, and the wider mode would apply to that one.
    if (error == std::errc{} && end == last && number != static_cast<gid_t>(-1)) return number;
    std::array<char, 1 << 16> buffer{};  // a group may have many members
    group entry{};
    group* known = nullptr;
    (void)getgrnam_r(text.c_str(), &entry, buffer.data(), buffer.size(), &known);
    return known == nullptr ? std::nullopt : std::optional<unsigned>(known->gr_gid);
}

std::string group_fault(const std::string& text) {
    return to_group(text) ? "" : "there is no group '" + text + "'";
}

}  // namespace raynest::server
