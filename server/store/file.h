// An open file or folder, which closes itself.
#pragma once

#include <fcntl.h>
#include <sys/types.h>
#include <unistd.h>

#include <filesystem>
#include <string>
#include <system_error>

namespace raynest::server {

class File {
public:
    /// Opens; errno tells why if that fails. Follows a symbolic link to a folder (O_DIRECTORY)
    /// alone.
    File(const std::filesystem::path& path, int flags, mode_t mode = 0)
        : number_(::open(path.c_str(),
                         flags | O_CLOEXEC | ((flags & O_DIRECTORY) != 0 ? 0 : O_NOFOLLOW), mode)) {
    }
    File(const File&) = delete;
    File& operator=(const File&) = delete;
    ~File() {
        if (number_ >= 0) ::close(number_);
    }
    [[nodiscard]] int number() const { return number_; }
    [[nodiscard]] bool is_open() const { return number_ >= 0; }

private:
    const int number_;
};

/// The system's words for an errno.
[[nodiscard]] inline std::string reason(int error) {
    return std::generic_category().message(error);
}

}  // namespace raynest::server
