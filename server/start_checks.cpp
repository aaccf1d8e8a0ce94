#include "server/start_checks.h"

#include "engine/packs/load.h"
#include "server/log.h"

#include <sys/resource.h>

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

/// Minimum number of file descriptors: the program's own files, an import, and a few clients.
constexpr rlim_t descriptors_min = 16;

void warn_of_unused_access(const Options& options) {
    const bool any_unix = std::ranges::any_of(
        options.listen, [](const std::string& uri) { return uri.starts_with("unix:"); });
    if (!any_unix && (options.socket.group || options.socket.mode != SocketAccess{}.mode))
        log(LogLevel::warn, "socket_access_unused",
            {{"reason", "--socket-mode and --socket-group need a --listen unix:PATH"}});
}

void warn_of_empty(const std::vector<std::filesystem::path>& pack_dirs) {
    for (const auto& folder : pack_dirs)
        if (const auto packs = packs_in(folder); packs && packs->empty())
            log(LogLevel::warn, "pack_dir_empty",
                {{"folder", folder.string()}, {"reason", "it holds no .so file"}});
}

}  // namespace

Result<void> raise_descriptor_limit() {
    rlimit limit{};
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return {};
    limit.rlim_cur = limit.rlim_max;
    (void)setrlimit(RLIMIT_NOFILE, &limit);
    if (limit.rlim_max >= descriptors_min) return {};
    return fail(ErrorCode::io_failed,
                "it may open " + std::to_string(limit.rlim_max) + " files and needs at least " +
                    std::to_string(descriptors_min) + "; raise LimitNOFILE or ulimit -n for it");
}

void warn_of_useless(const Options& options) {
    warn_of_empty(options.pack_dirs);
    warn_of_unused_access(options);
}

}  // namespace raynest::server
