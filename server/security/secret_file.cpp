#include "server/security/secret_file.h"

#include "engine/assets/child_process.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <system_error>
#include <utility>

namespace raynest::server {
namespace {

namespace fs = std::filesystem;

tl::unexpected<Error> failed(const fs::path& file, const std::string& why) {
    return fail(ErrorCode::io_failed, file.string() + ": " + why);
}

fs::path folder_of(const fs::path& file) {
    return file.has_parent_path() ? file.parent_path() : fs::path(".");
}

/// Says why a file cannot be opened, from errno.
std::string open_fault(const fs::path& file, Reader reader) {
    if (errno != EACCES) return std::strerror(errno);
    return std::string(std::strerror(errno)) +
           (reader == Reader::command
                ? "; run this command as root"
                : "; as root: chown " + std::to_string(geteuid()) + " " + file.string() +
                      ", and let that user enter its folder");
}

Result<void> check_secrecy(const fs::path& file, const struct stat& status, Reader reader) {
    const bool edits_all = reader == Reader::command && geteuid() == 0;
    if (status.st_uid != geteuid() && status.st_uid != 0 && !edits_all)
        return failed(file, "it belongs to another user; as root: chown " +
                                std::to_string(geteuid()) + " " + file.string());
    if ((status.st_mode & 077U) != 0)
        return failed(file, "other users may read or write it, and it holds a secret; chmod 600 " +
                                file.string());
    return {};
}

Result<std::string> read_whole(const fs::path& file, std::size_t bytes_max, Reader reader,
                               bool is_secret) {
    const Fd opened(open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY));
    if (opened.get() < 0) return failed(file, open_fault(file, reader));
    // Check the opened file, not the path, which may change meanwhile.
    struct stat status {};
    if (fstat(opened.get(), &status) != 0) return failed(file, std::strerror(errno));
    if (S_ISDIR(status.st_mode)) return failed(file, "it is a folder; name a file in it");
    if (!S_ISREG(status.st_mode)) return failed(file, "it is not a regular file");
    const std::string too_large = "it is over " + std::to_string(bytes_max) + " bytes";
    if (static_cast<std::size_t>(status.st_size) > bytes_max) return failed(file, too_large);
    if (is_secret)
        if (const auto good = check_secrecy(file, status, reader); !good)
            return tl::unexpected(good.error());
    std::string content(bytes_max + 1, '\0');
    std::size_t size = 0;
    while (size < content.size()) {
        const ssize_t got = read(opened.get(), content.data() + size, content.size() - size);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return failed(file, std::strerror(errno));
        if (got == 0) break;
        size += static_cast<std::size_t>(got);
    }
    if (size > bytes_max) return failed(file, too_large);
    content.resize(size);
    return content;
}

/// A new file beside its final place. It is removed again unless it is put there.
class StagedFile {
public:
    static Result<StagedFile> write(const NewFile& file);
    StagedFile(StagedFile&& other) noexcept
        : place_(std::move(other.place_)),
          name_(std::exchange(other.name_, {})) {}
    StagedFile(const StagedFile&) = delete;
    ~StagedFile() {
        if (!name_.empty()) unlink(name_.c_str());
    }
    Result<void> put() {
        if (rename(name_.c_str(), place_.c_str()) != 0) return failed(place_, std::strerror(errno));
        name_.clear();
        return {};
    }
    [[nodiscard]] const fs::path& place() const { return place_; }

private:
    explicit StagedFile(fs::path place) : place_(std::move(place)) {}
    Result<void> fill(int made, const std::string& content) const;

    fs::path place_;
    std::string name_;
};

Result<StagedFile> StagedFile::write(const NewFile& file) {
    StagedFile staged(file.path);
    std::string pattern = file.path.string() + ".XXXXXX";
    const Fd made(mkostemp(pattern.data(), O_CLOEXEC));
    if (made.get() < 0)
        return failed(file.path, std::string(std::strerror(errno)) +
                                     (errno == EACCES ? "; run this command as root, or as a user "
                                                        "who may write in " +
                                                            folder_of(file.path).string()
                                                      : ""));
    staged.name_ = pattern;
    if (auto filled = staged.fill(made.get(), file.content); !filled)
        return tl::unexpected(filled.error());
    return staged;
}

Result<void> StagedFile::fill(int made, const std::string& content) const {
    struct stat old {};
    const bool replaces = lstat(place_.c_str(), &old) == 0 && S_ISREG(old.st_mode);
    if (replaces && (old.st_uid != geteuid() || old.st_gid != getegid()) &&
        fchown(made, old.st_uid, old.st_gid) != 0 && old.st_uid != geteuid())
        return failed(place_, "its owner cannot be kept: " + std::string(std::strerror(errno)) +
                                  "; run this command as root");
    // After fchown(), which may take bits away.
    if (fchmod(made, replaces ? old.st_mode & 0777U : 0600U) != 0)
        return failed(place_, std::strerror(errno));
    for (std::string_view left = content; !left.empty();) {
        const ssize_t written = ::write(made, left.data(), left.size());
        if (written < 0 && errno != EINTR) return failed(place_, std::strerror(errno));
        if (written > 0) left.remove_prefix(static_cast<std::size_t>(written));
    }
    return fsync(made) == 0 ? Result<void>() : failed(place_, std::strerror(errno));
}

}  // namespace

Result<std::string> read_regular_file(const fs::path& file, std::size_t bytes_max) {
    return read_whole(file, bytes_max, Reader::daemon, false);
}

Result<std::string> read_secret_file(const fs::path& file, std::size_t bytes_max, Reader reader) {
    return read_whole(file, bytes_max, reader, true);
}

Result<fs::path> behind_links(const fs::path& file) {
    struct stat link {};
    if (lstat(file.c_str(), &link) != 0 || !S_ISLNK(link.st_mode)) return file;
    struct stat target {};
    if (stat(file.c_str(), &target) != 0)
        return failed(file, "what this link leads to: " + std::string(std::strerror(errno)) +
                                "; make it, or remove the link");
    if (link.st_uid != 0 && link.st_uid != geteuid() && link.st_uid != target.st_uid)
        return failed(file, "this link belongs to another user than its target; name the target");
    std::error_code error;
    fs::path found = fs::canonical(file, error);
    if (error) return failed(file, error.message());
    return found;
}

Result<void> write_files_atomically(const std::vector<NewFile>& files) {
    std::vector<StagedFile> staged;
    staged.reserve(files.size());
    for (const NewFile& file : files) {
        auto written = StagedFile::write(file);
        if (!written) return tl::unexpected(written.error());
        staged.push_back(std::move(*written));
    }
    for (StagedFile& file : staged)
        if (auto put = file.put(); !put) return put;
    // A failed sync of a folder loses nothing that can be told here: the files are in place.
    for (const StagedFile& file : staged) {
        const Fd held(open(folder_of(file.place()).c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
        if (held.get() >= 0) (void)fsync(held.get());
    }
    return {};
}

}  // namespace raynest::server
