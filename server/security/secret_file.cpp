#include "server/security/secret_file.h"

#include "engine/assets/child_process.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace raynest::server {
namespace {

tl::unexpected<Error> failed(const std::filesystem::path& file, const std::string& why) {
    return fail(ErrorCode::io_failed, file.string() + ": " + why);
}

Result<void> check_status(const std::filesystem::path& file, const struct stat& status) {
    if (!S_ISREG(status.st_mode)) return failed(file, "it is not a regular file");
    if (status.st_uid != geteuid() && status.st_uid != 0)
        return failed(file, "it belongs to another user; chown it to the daemon's user");
    if ((status.st_mode & 077U) != 0)
        return failed(file, "other users may read or write it, and it holds a secret; chmod 600 " +
                                file.string());
    return {};
}

}  // namespace

Result<void> check_secret_file(const std::filesystem::path& file) {
    struct stat status {};
    if (stat(file.c_str(), &status) != 0) return failed(file, std::strerror(errno));
    return check_status(file, status);
}

Result<std::string> read_secret_file(const std::filesystem::path& file, std::size_t bytes_max) {
    const Fd opened(open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
    if (opened.get() < 0) return failed(file, std::strerror(errno));
    // Check the opened file, not the path, which may change meanwhile.
    struct stat status {};
    if (fstat(opened.get(), &status) != 0) return failed(file, std::strerror(errno));
    if (const auto good = check_status(file, status); !good) return tl::unexpected(good.error());
    std::string content(bytes_max + 1, '\0');
    std::size_t size = 0;
    while (size < content.size()) {
        const ssize_t got = read(opened.get(), content.data() + size, content.size() - size);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return failed(file, std::strerror(errno));
        if (got == 0) break;
        size += static_cast<std::size_t>(got);
    }
    if (size > bytes_max)
        return failed(file, "it is over " + std::to_string(bytes_max) + " bytes");
    content.resize(size);
    return content;
}

Result<void> write_file_atomically(const std::filesystem::path& file, std::string_view content,
                                   unsigned mode) {
    std::string pattern = file.string() + ".XXXXXX";
    const Fd made(mkostemp(pattern.data(), O_CLOEXEC));
    if (made.get() < 0) return failed(file, std::strerror(errno));
    const auto give_up = [&] {
        const int why = errno;
        unlink(pattern.c_str());
        return failed(file, std::strerror(why));
    };
    for (std::string_view left = content; !left.empty();) {
        const ssize_t written = write(made.get(), left.data(), left.size());
        if (written < 0 && errno != EINTR) return give_up();
        if (written > 0) left.remove_prefix(static_cast<std::size_t>(written));
    }
    if (fchmod(made.get(), mode) != 0 || fsync(made.get()) != 0) return give_up();
    if (rename(pattern.c_str(), file.c_str()) != 0) return give_up();
    const std::filesystem::path folder =
        file.has_parent_path() ? file.parent_path() : std::filesystem::path(".");
    const Fd held(open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (held.get() >= 0) (void)fsync(held.get());
    return {};
}

}  // namespace raynest::server
