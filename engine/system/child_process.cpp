#include "engine/system/child_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <vector>

extern char** environ;

namespace raynest {
namespace {

/// Spawn attributes: a process group of its own, so that signals of the terminal reach only us.
class Attributes {
public:
    Attributes() {
        posix_spawnattr_init(&attributes_);
        posix_spawnattr_setflags(&attributes_, POSIX_SPAWN_SETPGROUP);
        posix_spawnattr_setpgroup(&attributes_, 0);
    }
    Attributes(const Attributes&) = delete;
    Attributes& operator=(const Attributes&) = delete;
    ~Attributes() { posix_spawnattr_destroy(&attributes_); }
    [[nodiscard]] const posix_spawnattr_t* get() const { return &attributes_; }

private:
    posix_spawnattr_t attributes_{};
};

/// posix_spawn's file actions, freed on every path.
class FileActions {
public:
    FileActions() { posix_spawn_file_actions_init(&actions_); }
    FileActions(const FileActions&) = delete;
    FileActions& operator=(const FileActions&) = delete;
    ~FileActions() { posix_spawn_file_actions_destroy(&actions_); }
    [[nodiscard]] posix_spawn_file_actions_t* get() { return &actions_; }

private:
    posix_spawn_file_actions_t actions_{};
};

}  // namespace

Fd::~Fd() {
    if (fd_ >= 0) ::close(fd_);
}

Mapping::Mapping(const Fd& file, Access access) {
    struct stat status {};
    if (::fstat(file.get(), &status) != 0 || status.st_size <= 0) return;
    const auto size = static_cast<std::size_t>(status.st_size);
    const bool shared = access == Access::share;
    void* const at = ::mmap(nullptr, size, shared ? PROT_READ | PROT_WRITE : PROT_READ,
                            shared ? MAP_SHARED : MAP_PRIVATE, file.get(), 0);
    if (at != MAP_FAILED) bytes_ = {static_cast<std::byte*>(at), size};
}

Mapping::~Mapping() {
    if (!bytes_.empty()) ::munmap(bytes_.data(), bytes_.size());
}

std::string system_says(int error) {
    if (error == EMFILE)
        return "all file descriptors of this process are used up; raise LimitNOFILE or ulimit -n";
    if (error == ENFILE)
        return "all file descriptors of this machine are used up; raise fs.file-max";
    return std::strerror(error);
}

Fd out_of_the_way(Fd fd) {
    if (fd.get() < 0) return fd;
    return Fd(::fcntl(fd.get(), F_DUPFD_CLOEXEC, first_inherited_fd + inherited_max));
}

Result<Fd> create_memory_file(const char* name) {
    Fd file = out_of_the_way(Fd(::memfd_create(name, MFD_CLOEXEC | MFD_ALLOW_SEALING)));
    if (file.get() >= 0) return file;
    return fail(ErrorCode::io_failed,
                fmt::format("creating a memory file: {}", system_says(errno)));
}

Result<void> write_all(int fd, const void* bytes, std::size_t size) {
    const auto* at = static_cast<const char*>(bytes);
    while (size != 0) {
        const ssize_t written = ::write(fd, at, std::min(size, std::size_t{1} << 30));
        if (written < 0 && errno == EINTR) continue;
        if (written <= 0) {
            return fail(ErrorCode::io_failed,
                        fmt::format("writing to a memory file: {}", std::strerror(errno)));
        }
        at += written;
        size -= static_cast<std::size_t>(written);
    }
    return {};
}

Result<pid_t> spawn_child(std::span<const std::string> command, std::span<const int> inherited) {
    FileActions actions;
    int failed = posix_spawn_file_actions_addopen(actions.get(), 0, "/dev/null", O_RDONLY, 0);
    for (const int output : {1, 2}) {
        failed |= posix_spawn_file_actions_addopen(actions.get(), output, "/dev/null", O_WRONLY, 0);
    }
    int next = first_inherited_fd;
    for (const int fd : inherited) {
        failed |= posix_spawn_file_actions_adddup2(actions.get(), fd, next++);
    }
    failed |= posix_spawn_file_actions_addclosefrom_np(actions.get(), next);

    std::vector<std::string> words(command.begin(), command.end());
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    pid_t pid = 0;
    if (failed == 0)
        failed = posix_spawnp(&pid, arguments[0], actions.get(), Attributes().get(),
                              arguments.data(), environ);
    if (failed == 0) return pid;
    return fail(ErrorCode::io_failed,
                fmt::format("'{}' does not start: {}", command[0], system_says(failed)));
}

std::optional<int> end_group(pid_t child) {
    siginfo_t state{};
    if (::waitid(P_PID, static_cast<id_t>(child), &state, WEXITED | WNOHANG | WNOWAIT) != 0)
        return std::nullopt;
    // The number is the group's until the child is reaped.
    ::kill(-child, SIGKILL);
    int status = 0;
    pid_t ended = 0;
    do ended = ::waitpid(child, &status, 0);
    while (ended < 0 && errno == EINTR);
    return ended == child ? std::optional(status) : std::nullopt;
}

bool bind_to_parent(pid_t parent) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    const rlimit none{0, 0};
    static_cast<void>(::setrlimit(RLIMIT_CORE, &none));
    // The parent may have ended before the death signal was set.
    return ::getppid() == parent;
}

}  // namespace raynest
