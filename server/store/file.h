// An open file or folder, which closes itself.
#pragma once

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <string>
#include <system_error>
#include <utility>

namespace raynest::server {

/// Stands in errno for a file that is a link, a pipe or a device: whoever opens one may wait for ever.
inline constexpr int not_a_file = EMEDIUMTYPE;

class File {
public:
    /// Opens a regular file or, with O_DIRECTORY, a folder; errno tells why if that fails. Follows a
    /// symbolic link to a folder alone.
    File(const std::filesystem::path& path, int flags, mode_t mode = 0)
        : number_(
              ::open(path.c_str(),
                     flags | O_CLOEXEC | O_NONBLOCK | ((flags & O_DIRECTORY) != 0 ? 0 : O_NOFOLLOW),
                     mode)) {
        struct stat found {};
        if ((flags & O_DIRECTORY) != 0) return;
        if (number_ < 0 && errno == ELOOP) errno = not_a_file;  // a link
        if (number_ < 0) return;
        if (::fstat(number_, &found) == 0 && S_ISREG(found.st_mode)) return;
        ::close(std::exchange(number_, -1));
        errno = not_a_file;
    }
    File(const File&) = delete;
    File& operator=(const File&) = delete;
    ~File() {
        if (number_ >= 0) ::close(number_);
    }
    [[nodiscard]] int number() const { return number_; }
    [[nodiscard]] bool is_open() const { return number_ >= 0; }

private:
    int number_;
};

/// Has the names in a folder on the disk; errno tells why if that fails.
[[nodiscard]] inline bool flush_folder(const std::filesystem::path& folder) {
    const File file(folder, O_RDONLY | O_DIRECTORY);
    return file.is_open() && ::fsync(file.number()) == 0;
}

/// The system's words for an errno.
[[nodiscard]] inline std::string reason(int error) {
    return error == not_a_file ? "it is no regular file" : std::generic_category().message(error);
}

}  // namespace raynest::server
