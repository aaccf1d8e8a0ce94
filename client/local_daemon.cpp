#include "client/local_daemon.h"

#include "client/descriptor.h"
#include "client/interrupt.h"

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <optional>
#include <sstream>
#include <thread>
#include <vector>

namespace raynest::client {
namespace {

using Clock = std::chrono::steady_clock;
namespace fs = std::filesystem;

constexpr std::chrono::seconds start_time{30};
/// The daemon cancels its jobs first; after this time it is killed.
constexpr std::chrono::seconds end_time{5};
constexpr std::chrono::milliseconds look_time{5};

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

tl::unexpected<Failure> cannot(const char* what) {
    return cannot_start(std::string(what) + ": " + std::strerror(errno));
}

/// The last line of a log, which says why a daemon ended.
std::string last_line(const fs::path& file) {
    std::ifstream log(file);
    std::string last = "it said nothing";
    for (std::string line; std::getline(log, line);)
        if (!line.empty()) last = line;
    return last;
}

/// Runs in the child between fork() and exec(): only calls that are safe there.
[[noreturn]] void become(const char* const* arguments, int log, pid_t parent) {
    // A Ctrl-C of the terminal is for the client, which cancels its job and then ends the daemon.
    (void)::setpgid(0, 0);
    (void)::prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (::getppid() != parent) ::_exit(1);
    const int null = ::open("/dev/null", O_RDWR | O_CLOEXEC);
    (void)::dup2(null, STDIN_FILENO);
    (void)::dup2(null, STDOUT_FILENO);
    (void)::dup2(log, STDERR_FILENO);
    (void)::signal(SIGPIPE, SIG_DFL);
    ::execv(arguments[0], const_cast<char* const*>(arguments));
    const char* why = std::strerror(errno);
    (void)!::write(STDERR_FILENO, why, std::strlen(why));
    ::_exit(1);
}

}  // namespace

Result<LocalDaemon> LocalDaemon::start() {
    const auto program = find_daemon();
    if (!program)
        return cannot_start(
            "there is no raynestd beside raynest, nor on PATH; install it there, or start one "
            "elsewhere and name it with --server");
    LocalDaemon daemon;
    if (auto made = daemon.make_folder(); !made) return tl::unexpected<Failure>(made.error());
    if (auto running = daemon.run(*program); !running)
        return tl::unexpected<Failure>(running.error());
    if (auto ready = daemon.await_ready(); !ready) return tl::unexpected<Failure>(ready.error());
    return daemon;
}

Result<void> LocalDaemon::make_folder() {
    std::error_code error;
    std::string pattern = (fs::temp_directory_path(error) / "raynest-XXXXXX").string();
    // A socket's path has a limit that a long TMPDIR exceeds.
    if (error || pattern.size() + sizeof("/socket") > sizeof(sockaddr_un::sun_path))
        pattern = "/tmp/raynest-XXXXXX";
    if (::mkdtemp(pattern.data()) == nullptr) return cannot("a folder in TMPDIR");
    folder_ = pattern;
    return {};
}

Result<void> LocalDaemon::run(const std::string& program) {
    const std::string listen = uri();
    const std::string ready = folder_ / "ready";
    const std::array<const char*, 10> words = {
        program.c_str(), "--listen", listen.c_str(), "--ready-file", ready.c_str(),
        "--http",        "off",      "--log-level",  "error",        nullptr};
    const Descriptor log(
        ::open((folder_ / "log").c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600));
    if (!log) return cannot("its log");
    const pid_t parent = ::getpid();
    process_ = ::fork();
    if (process_ == 0) become(words.data(), log.number(), parent);
    if (process_ < 0) return cannot("fork");
    return {};
}

Result<void> LocalDaemon::await_ready() {
    const Clock::time_point end = Clock::now() + start_time;
    std::error_code ignored;
    while (!fs::exists(folder_ / "ready", ignored)) {
        if (interrupted()) return fail(Exit::interrupted, "interrupted");
        if (::waitpid(process_, nullptr, WNOHANG) == process_) {
            process_ = -1;
            return cannot_start(last_line(folder_ / "log"));
        }
        if (Clock::now() > end) return cannot_start("it was not ready within 30 s");
        std::this_thread::sleep_for(look_time);
    }
    return {};
}

void LocalDaemon::hide() {
    std::error_code ignored;
    if (!folder_.empty()) fs::remove_all(folder_, ignored);
    folder_.clear();
}

LocalDaemon::~LocalDaemon() {
    if (process_ > 0) {
        (void)::kill(process_, SIGTERM);
        const Clock::time_point end = Clock::now() + end_time;
        while (::waitpid(process_, nullptr, WNOHANG) == 0) {
            if (Clock::now() > end) {
                (void)::kill(process_, SIGKILL);
                (void)::waitpid(process_, nullptr, 0);
                break;
            }
            std::this_thread::sleep_for(look_time);
        }
    }
    hide();
}

}  // namespace raynest::client
