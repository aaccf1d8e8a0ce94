// A folder for a socket, which only this user can open. It goes with its object.
#pragma once

#include "client/ground/failure.h"

#include <sys/un.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <string>
#include <utility>

namespace raynest::client {

class TemporaryFolder {
public:
    /// Makes one in TMPDIR, or in /tmp where a socket's path would be too long. Fails with exit
    /// code 3.
    static Result<TemporaryFolder> make() {
        std::error_code error;
        std::string pattern =
            (std::filesystem::temp_directory_path(error) / "raynest-XXXXXX").string();
        if (error || pattern.size() + sizeof("/socket") > sizeof(sockaddr_un::sun_path))
            pattern = "/tmp/raynest-XXXXXX";
        if (::mkdtemp(pattern.data()) == nullptr)
            return fail(Exit::cannot_connect,
                        "cannot make a folder like " + pattern + ": " + std::strerror(errno));
        return TemporaryFolder(pattern);
    }
    TemporaryFolder(TemporaryFolder&& other) noexcept : path_(std::exchange(other.path_, {})) {}
    TemporaryFolder& operator=(TemporaryFolder&&) = delete;
    TemporaryFolder(const TemporaryFolder&) = delete;
    ~TemporaryFolder() { remove(); }

    [[nodiscard]] const std::filesystem::path& path() const { return path_; }
    /// Removes the folder with all that is in it. path() is empty from then on.
    void remove() {
        std::error_code ignored;
        if (!path_.empty()) std::filesystem::remove_all(std::exchange(path_, {}), ignored);
    }

private:
    explicit TemporaryFolder(std::filesystem::path path) : path_(std::move(path)) {}
    std::filesystem::path path_;
};

}  // namespace raynest::client
