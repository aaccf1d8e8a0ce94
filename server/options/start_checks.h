// Checks of the daemon before it starts.
#pragma once

#include "engine/result.h"
#include "server/options/options.h"
#include "server/options/ready_file.h"

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

/// Raises the limit of file descriptors to the maximum that the system grants, and locks the state
/// folder. Fails if too few descriptors are granted for the daemon and a few clients, if a module of
/// its own is cut short, if another program has the ready file, if others can change the folder, or
/// if another daemon has it; with --takeover the lock is then empty.
[[nodiscard]] Result<StateLock> prepare_start(const Options& options);

/// Returns the first option for which the daemon could not start: files of TLS, tokens, packs, the
/// state folder, folders of sockets. Binds no address and takes no lock, so a daemon may run
/// meanwhile.
[[nodiscard]] std::optional<OptionFault> start_fault(const Options& options);

/// Something that a daemon starts with, and its administrator should know.
struct StartWarning {
    const char* event;
    std::string reason;
};

/// Returns options without an effect, such as folders without kernel packs, and what makes the
/// daemon less safe than it could be: parts of the import process's sandbox that this build or
/// kernel lacks, a CA's key that this user can read, a state folder that others can look into, or
/// `load = ["root:..."]` without a folder.
[[nodiscard]] std::vector<StartWarning> start_warnings(const Options& options);

/// Root that checks the package's configuration becomes the user of the package's service: the
/// files must be good for that user. Returns its name; empty if this process stays whose it is.
/// Call it only in a process that ends after the check.
[[nodiscard]] std::string become_service_user(const std::filesystem::path& config);

}  // namespace raynest::server
