#include "server/options/limits_in_force.h"

#include <array>
#include <cstdint>
#include <filesystem>
#include <system_error>

namespace raynest::server {
namespace {

/// A limit that is by default a part of --memory, or of the disk of --state.
struct Part {
    const char* option;
    std::uint64_t protocol::Limits::*limit;
    std::uint64_t parts;
    bool is_of_disk;
};
constexpr std::array<Part, 3> table = {{
    {"--principal-scene-bytes-max", &protocol::Limits::principal_scene_bytes_max, 2, false},
    {"--principal-result-bytes-max", &protocol::Limits::principal_result_bytes_max, 8, false},
    {"--principal-disk-bytes-max", &protocol::Limits::principal_disk_bytes_max, 2, true},
}};

/// Returns the size of the disk of a folder that may be made later, that of the nearest one above
/// which is there; 0 if it is unknown.
std::uint64_t disk_of(const std::filesystem::path& folder) {
    std::error_code error;
    std::filesystem::path path = std::filesystem::absolute(folder, error);
    while (!error && path.has_relative_path() && !std::filesystem::exists(path, error))
        path = path.parent_path();
    if (error) return 0;
    const auto disk = std::filesystem::space(path, error);
    return error ? 0 : disk.capacity;
}

}  // namespace

const std::vector<std::string>& derived_limits() {
    static const std::vector<std::string> options = [] {
        std::vector<std::string> names;
        for (const Part& part : table) names.emplace_back(part.option);
        return names;
    }();
    return options;
}

void forget_defaults(protocol::Limits& limits,
                     const std::function<bool(const std::string&)>& is_default) {
    for (const Part& part : table)
        if (is_default(part.option)) limits.*part.limit = 0;
}

protocol::Limits limits_in_force(const Options& options) {
    protocol::Limits limits = options.limits;
    for (const Part& part : table) {
        if (limits.*part.limit != 0) continue;
        const std::uint64_t whole = !part.is_of_disk        ? options.memory
                                    : options.state.empty() ? 0
                                                            : disk_of(options.state);
        limits.*part.limit = whole != 0 ? whole / part.parts : protocol::Limits().*part.limit;
    }
    return limits;
}

}  // namespace raynest::server
