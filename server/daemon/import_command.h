// The command line that makes this program an import process (main.cpp).
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

/// The command line of the import process (engine/assets/sandbox/import_child.h) is
/// `raynestd --import-child TARGET [PACK_DIR...]`.
inline constexpr std::string_view import_child_flag = "--import-child";

/// Returns that command line. The packs are passed on because they decide which primitives a file
/// may hold.
[[nodiscard]] inline std::vector<std::string> import_command(
    const std::string& target, const std::vector<std::filesystem::path>& pack_dirs) {
    std::vector<std::string> command = {std::filesystem::read_symlink("/proc/self/exe").string(),
                                        std::string(import_child_flag), target};
    for (const auto& folder : pack_dirs)
        command.push_back(std::filesystem::absolute(folder).string());
    return command;
}

}  // namespace raynest::server
