#include "client/ground/child_process.h"

#include <fcntl.h>
#include <linux/close_range.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <string_view>
#include <thread>

extern char** environ;

namespace raynest::client {
namespace {

using Clock = std::chrono::steady_clock;

/// Time for a child to end by itself: a daemon cancels its jobs first.
constexpr std::chrono::seconds end_time{5};
/// The end of a log that last_line() reads.
constexpr off_t line_bytes_max = 4096;

std::vector<char*> pointers(std::vector<std::string>& words) {
    std::vector<char*> list;
    for (std::string& word : words) list.push_back(word.data());
    list.push_back(nullptr);
    return list;
}

std::vector<char*> environment_without_token() {
    std::vector<char*> list;
    for (char** entry = environ; *entry != nullptr; ++entry)
        if (!std::string_view(*entry).starts_with("RAYNEST_TOKEN=")) list.push_back(*entry);
    list.push_back(nullptr);
    return list;
}

/// Runs in the child between fork() and exec(): only calls that are safe there. Writes errno to
/// `report` where the program cannot be started.
[[noreturn]] void become(char* const* words, char* const* environment, ChildKind kind, int log,
                         int report, pid_t parent) {
    if (kind == ChildKind::asking) (void)::signal(SIGINT, SIG_IGN);
    if (kind == ChildKind::silent) (void)::setpgid(0, 0);
    if (kind == ChildKind::independent) (void)::setsid();
    if (kind != ChildKind::independent) (void)::prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (kind != ChildKind::independent && ::getppid() != parent) ::_exit(1);
    const int null = ::open("/dev/null", O_RDWR | O_CLOEXEC);
    (void)::dup2(null, STDIN_FILENO);
    (void)::dup2(null, STDOUT_FILENO);
    (void)::dup2(log, STDERR_FILENO);
    (void)::close_range(STDERR_FILENO + 1, ~0U, CLOSE_RANGE_CLOEXEC);
    (void)::signal(SIGPIPE, SIG_DFL);
    ::execvpe(words[0], words, environment);
    const int why = errno;
    (void)!::write(report, &why, sizeof why);
    ::_exit(1);
}

}  // namespace

Result<ChildProcess> ChildProcess::start(std::vector<std::string> words, ChildKind kind) {
    const auto cannot = [](int why) { return fail(Exit::cannot_connect, std::strerror(why)); };
    std::array<int, 2> pipe{};
    // A browser would fill the memory with its lines, for hours.
    Descriptor log(kind == ChildKind::independent ? ::open("/dev/null", O_RDWR | O_CLOEXEC)
                                                  : ::memfd_create("log", MFD_CLOEXEC));
    if (!log || ::fcntl(log.number(), F_SETFL, O_APPEND) != 0 ||
        ::pipe2(pipe.data(), O_CLOEXEC) != 0)
        return cannot(errno);
    const Descriptor report(pipe[0]);
    Descriptor reporting(pipe[1]);
    const std::vector<char*> arguments = pointers(words), environment = environment_without_token();
    const pid_t parent = ::getpid();
    ChildProcess child(kind, std::move(log));
    child.id_ = ::fork();
    if (child.id_ == 0)
        become(arguments.data(), environment.data(), kind, child.log_.number(), reporting.number(),
               parent);
    if (child.id_ < 0) return cannot(errno);
    reporting = Descriptor();
    int why = 0;
    if (::read(report.number(), &why, sizeof why) == sizeof why) return cannot(why);
    return child;
}

ChildProcess::~ChildProcess() {
    if (id_ <= 0 || !ends_) return;
    (void)::kill(id_, SIGTERM);
    const Clock::time_point end = Clock::now() + end_time;
    while (!has_ended()) {
        if (Clock::now() > end) {
            (void)::kill(id_, SIGKILL);
            (void)::waitpid(id_, nullptr, 0);
            return;
        }
        std::this_thread::sleep_for(look_time);
    }
}

bool ChildProcess::has_ended(int* status) {
    int ended = 0;
    if (id_ <= 0 || ::waitpid(id_, &ended, WNOHANG) != id_) return id_ <= 0;
    id_ = -1;
    if (status != nullptr) *status = ended;
    return true;
}

std::string ChildProcess::last_line() const {
    struct stat status {};
    std::string text(static_cast<std::size_t>(line_bytes_max), '\0');
    if (::fstat(log_.number(), &status) != 0) return "";
    const off_t begin = std::max<off_t>(0, status.st_size - line_bytes_max);
    const ssize_t got = ::pread(log_.number(), text.data(), text.size(), begin);
    text.resize(got < 0 ? 0 : static_cast<std::size_t>(got));
    text.erase(text.find_last_not_of("\r\n") + 1);
    return text.substr(text.find_last_of("\r\n") + 1);
}

}  // namespace raynest::client
