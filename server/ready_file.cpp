#include "server/ready_file.h"

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <fstream>
#include <system_error>

namespace raynest::server {

Result<void> write_ready_file(const std::filesystem::path& path,
                              std::span<const std::string> listen) {
    const nlohmann::json content = {
        {"listen", std::vector<std::string>(listen.begin(), listen.end())},
        {"http", "off"},
        {"pid", getpid()},
    };
    std::filesystem::path temporary = path;
    temporary += ".tmp";
    std::ofstream out(temporary, std::ios::trunc);
    out << content.dump() << '\n';
    out.close();
    std::error_code error;
    if (out) std::filesystem::rename(temporary, path, error);
    if (!out || error)
        return fail(ErrorCode::io_failed,
                    "cannot write the ready file " + path.string() +
                        "; give --ready-file a name in a folder that can be written");
    return {};
}

Result<StateLock> StateLock::take(const std::filesystem::path& directory) {
    std::error_code error;
    if (std::filesystem::create_directories(directory, error))
        std::filesystem::permissions(directory, std::filesystem::perms::owner_all, error);
    StateLock lock;
    lock.descriptor_ =
        open((directory / "lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
    if (lock.descriptor_ < 0)
        return fail(ErrorCode::io_failed,
                    "cannot open " + (directory / "lock").string() + ": " +
                        std::error_code(errno, std::generic_category()).message() +
                        "; give --state a folder that can be written");
    if (flock(lock.descriptor_, LOCK_EX | LOCK_NB) != 0)
        return fail(ErrorCode::io_failed, "another daemon uses " + directory.string() +
                                              "; stop it or give --state another folder");
    return lock;
}

StateLock::~StateLock() {
    if (descriptor_ >= 0) close(descriptor_);
}

}  // namespace raynest::server
