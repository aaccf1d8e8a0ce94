#include "server/options/ready_file.h"

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <optional>
#include <system_error>

namespace raynest::server {

namespace {

/// Maximum size of a ready file; larger than any with one address for each --listen.
constexpr off_t ready_file_bytes_max = 1 << 20;
constexpr int names_max = 100;

/// Returns the pid in a ready file; 0 for an empty file, nothing for anything else.
std::optional<std::int64_t> pid_of(const std::filesystem::path& path) {
    // Check the opened file, not the path, which may change meanwhile.
    const Fd file(open(path.c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC));
    struct stat status {};
    if (file.get() < 0 || fstat(file.get(), &status) != 0 || !S_ISREG(status.st_mode) ||
        status.st_size > ready_file_bytes_max)
        return std::nullopt;
    if (status.st_size == 0) return 0;
    std::string text(static_cast<std::size_t>(status.st_size), '\0');
    if (read(file.get(), text.data(), text.size()) != status.st_size) return std::nullopt;
    const auto content = nlohmann::json::parse(text, nullptr, false);
    const bool ours = content.is_object() && content.size() == 3 && content.contains("listen") &&
                      content.contains("http") && content.contains("pid") &&
                      content["pid"].is_number_integer();
    return ours ? std::optional(content["pid"].get<std::int64_t>()) : std::nullopt;
}

tl::unexpected<Error> not_written(const std::filesystem::path& path) {
    return fail(ErrorCode::io_failed,
                "cannot write the ready file " + path.string() +
                    "; give --ready-file a name in a folder that can be written");
}

/// Creates a file in the folder of `path`. Returns its descriptor, or -1 on failure.
int make_beside(const std::filesystem::path& path, std::filesystem::path& made) {
    const std::string stem = ".raynest-ready-" + std::to_string(getpid()) + "-";
    for (int i = 0; i < names_max; ++i) {
        made = path.parent_path() / (stem + std::to_string(i));
        const int file = open(made.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
        if (file >= 0 || errno != EEXIST) return file;
    }
    return -1;
}

}  // namespace

Result<void> check_ready_file(const std::filesystem::path& path) {
    std::error_code error;
    const auto status = std::filesystem::symlink_status(path, error);
    if (!std::filesystem::is_directory(std::filesystem::absolute(path, error).parent_path(), error))
        return not_written(path);
    if (status.type() == std::filesystem::file_type::not_found || pid_of(path)) return {};
    return fail(ErrorCode::io_failed,
                path.string() +
                    " is neither empty nor a ready file, and is left as it is; give "
                    "--ready-file another name");
}

Result<void> write_ready_file(const std::filesystem::path& path,
                              std::span<const std::string> listen, const std::string& http) {
    if (auto free = check_ready_file(path); !free) return free;
    const nlohmann::json content = {
        {"listen", std::vector<std::string>(listen.begin(), listen.end())},
        {"http", http},
        {"pid", getpid()},
    };
    const std::string text = content.dump() + '\n';
    std::filesystem::path temporary;
    const int file = make_beside(path, temporary);
    if (file < 0) return not_written(path);
    const bool written = write(file, text.data(), text.size()) == static_cast<ssize_t>(text.size());
    const bool closed = close(file) == 0;
    std::error_code error;
    if (written && closed) std::filesystem::rename(temporary, path, error);
    if (written && closed && !error) return {};
    std::filesystem::remove(temporary, error);
    return not_written(path);
}

void remove_ready_file(const std::filesystem::path& path) {
    std::error_code ignored;
    if (pid_of(path) == getpid()) std::filesystem::remove(path, ignored);
}

namespace {

tl::unexpected<Error> in_use(const std::filesystem::path& directory) {
    return fail(ErrorCode::io_failed,
                "another daemon uses " + directory.string() + "; stop it or name another folder");
}

}  // namespace

Result<StateLock> StateLock::take(const std::filesystem::path& directory) {
    std::error_code error;
    if (std::filesystem::create_directories(directory, error))
        std::filesystem::permissions(directory, std::filesystem::perms::owner_all, error);
    StateLock lock;
    lock.descriptor_ =
        Fd(open((directory / "lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
    if (lock.descriptor() < 0)
        return fail(ErrorCode::io_failed,
                    "cannot open " + (directory / "lock").string() + ": " +
                        std::error_code(errno, std::generic_category()).message() +
                        "; name a folder that can be written");
    if (flock(lock.descriptor(), LOCK_EX | LOCK_NB) != 0) return in_use(directory);
    return lock;
}

Result<StateLock> StateLock::take_to_read(const std::filesystem::path& directory) {
    const std::string file = (directory / "lock").string();
    const auto is_read_only = [] { return errno == EROFS || errno == EACCES || errno == EPERM; };
    StateLock lock;
    lock.descriptor_ = Fd(open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
    const bool can_write = lock.descriptor() >= 0;
    if (!can_write && is_read_only())
        lock.descriptor_ = Fd(open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
    if (lock.descriptor() < 0) {
        if (errno == ENOENT || is_read_only()) return lock;
        return fail(ErrorCode::io_failed,
                    "cannot open " + file + ": " +
                        std::error_code(errno, std::generic_category()).message());
    }
    if (flock(lock.descriptor(), LOCK_EX | LOCK_NB) == 0) return lock;
    if (can_write || errno == EWOULDBLOCK) return in_use(directory);
    return StateLock();
}

StateLock StateLock::adopt(Fd descriptor) {
    StateLock lock;
    lock.descriptor_ = std::move(descriptor);
    return lock;
}

}  // namespace raynest::server
