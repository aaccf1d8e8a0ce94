#include "client/net/local_daemon.h"

#include "client/ground/interrupt.h"

#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <sstream>
#include <thread>
#include <vector>

namespace raynest::client {
namespace {

using Clock = std::chrono::steady_clock;
namespace fs = std::filesystem;

constexpr std::chrono::seconds daemon_start_time{30};

bool is_program(const fs::path& path) {
    std::error_code ignored;
    return fs::is_regular_file(path, ignored) && ::access(path.c_str(), X_OK) == 0;
}

/// The raynestd of this program's folder, where a build and a package put both, else of PATH.
std::optional<std::string> find_daemon() {
    std::error_code error;
    const fs::path self = fs::read_symlink("/proc/self/exe", error);
    std::vector<fs::path> folders;
    if (!error) folders.push_back(self.parent_path());
    const char* path = std::getenv("PATH");
    std::istringstream list(path != nullptr ? path : "");
    for (std::string folder; std::getline(list, folder, ':');)
        folders.emplace_back(folder.empty() ? "." : folder);
    for (const fs::path& folder : folders)
        if (is_program(folder / "raynestd")) return (folder / "raynestd").string();
    return std::nullopt;
}

tl::unexpected<Failure> cannot_start(const std::string& why) {
    return fail(Exit::cannot_connect, "cannot start a daemon for --local: " + why);
}

}  // namespace

void name_daemon() {
    // No other thread has started yet.
    if (const auto program = find_daemon())
        ::setenv("RAYNESTD", program->c_str(), 0);  // NOLINT(concurrency-mt-unsafe)
}

Result<LocalDaemon> LocalDaemon::start() {
    const auto program = find_daemon();
    if (!program)
        return cannot_start(
            "there is no raynestd beside raynest, nor on PATH; install it there, or start one "
            "elsewhere and name it with --server");
    auto folder = TemporaryFolder::make();
    if (!folder) return cannot_start(folder.error().message);
    auto process = ChildProcess::start(
        {*program, "--listen", "unix:" + (folder->path() / "socket").string(), "--ready-file",
         (folder->path() / "ready").string(), "--http", "off", "--log-level", "error"},
        ChildKind::silent);
    if (!process) return cannot_start(process.error().message);
    LocalDaemon daemon(std::move(*folder), std::move(*process));
    if (auto ready = daemon.await_ready(); !ready) return tl::unexpected<Failure>(ready.error());
    return daemon;
}

Result<void> LocalDaemon::await_ready() {
    const Clock::time_point end = Clock::now() + daemon_start_time;
    std::error_code ignored;
    while (!fs::exists(folder_.path() / "ready", ignored)) {
        if (interrupted()) return fail(Exit::interrupted, "interrupted");
        if (process_.has_ended()) {
            const std::string line = process_.last_line();
            return cannot_start(line.empty() ? "it said nothing" : line);
        }
        if (Clock::now() > end) return cannot_start("it was not ready within 30 s");
        std::this_thread::sleep_for(look_time);
    }
    return {};
}

}  // namespace raynest::client
