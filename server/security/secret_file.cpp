#include "server/security/secret_file.h"

#include "engine/system/child_process.h"

#include <fcntl.h>
#include <pwd.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string_view>
#include <utility>

namespace raynest::server {
namespace {

namespace fs = std::filesystem;

/// Returns the name of a user; its number if it has none.
std::string user_name(uid_t user) {
    std::array<char, 4096> text{};
    passwd entry{};
    passwd* found = nullptr;
    (void)getpwuid_r(user, &entry, text.data(), text.size(), &found);
    return found == nullptr ? std::to_string(user) : found->pw_name;
}

/// Says how root lets this process read a file.
std::string own_it(const fs::path& file) {
    return "as root: chown " + user_name(geteuid()) + " " + file.string();
}

/// Says why a file cannot be opened, from errno.
std::string open_fault(const fs::path& file, Reader reader) {
    const int why = errno;
    if (why == ELOOP) return "it became a link just now; run the command again";
    if (why != EACCES) return std::strerror(why);
    return std::string(std::strerror(why)) + "; " +
           (reader == Reader::command
                ? "run this command as root"
                : own_it(file) +
                      ", or chmod 640 it with a group of that user's; and let "
                      "that user enter its folder");
}

bool is_in(gid_t group) {
    if (group == getegid()) return true;
    std::vector<gid_t> groups(static_cast<std::size_t>(std::max(getgroups(0, nullptr), 0)));
    const int count = getgroups(static_cast<int>(groups.size()), groups.data());
    groups.resize(static_cast<std::size_t>(std::max(count, 0)));
    return std::ranges::find(groups, group) != groups.end();
}

/// Says what to do about a file that belongs to neither this user nor root.
std::string owner_fault(const fs::path& file, uid_t owner, Reader reader) {
    if (reader == Reader::signer)
        return "it belongs to the user " + user_name(owner) +
               ", who can sign with it; chown root " + file.string() +
               ", or make another CA in an empty DIR: raynestd tls init DIR";
    if (geteuid() == 0)
        return "it belongs to the user " + user_name(owner) +
               "; run the daemon as that user, or give the file to the one that it runs as: chown "
               "USER " +
               file.string();
    return "it belongs to another user; " + own_it(file);
}

Result<void> check_secrecy(const fs::path& file, const struct stat& status, Reader reader) {
    const bool edits_all = reader == Reader::command && geteuid() == 0;
    if (status.st_uid != geteuid() && status.st_uid != 0 && !edits_all)
        return file_failed(file, owner_fault(file, status.st_uid, reader));
    // Root's group has the number 0; an access list, as LoadCredential= makes, shows as its rights.
    const bool is_shared = reader != Reader::signer && status.st_uid == 0 &&
                           (status.st_mode & 037U) == 0 &&
                           (status.st_gid == 0 ||
                            ((edits_all || is_in(status.st_gid)) && !is_everybodys(status.st_gid)));
    if ((status.st_mode & 077U) != 0 && !is_shared)
        return file_failed(
            file, "other users may read or write it, and it holds a secret; chmod 600 " +
                      file.string() +
                      (reader == Reader::signer
                           ? ""
                           : ", or let root own it, with mode 640 and a group of the daemon"));
    return {};
}

constexpr int open_flags = O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY | O_NOFOLLOW;

Result<std::string> read_whole(const Result<FilePlace>& place, const fs::path& file,
                               std::size_t bytes_max, Reader reader, bool is_secret) {
    if (!place) return tl::unexpected(place.error());
    const Fd opened(openat(place->folder(), place->name().c_str(), open_flags));
    if (opened.get() < 0) return file_failed(file, open_fault(file, reader));
    // Check the opened file, not the path, which may change meanwhile.
    struct stat status {};
    if (fstat(opened.get(), &status) != 0) return file_failed(file, std::strerror(errno));
    if (S_ISDIR(status.st_mode)) return file_failed(file, "it is a folder; name a file in it");
    if (!S_ISREG(status.st_mode)) return file_failed(file, "it is not a regular file");
    const std::string too_large = "it is over " + std::to_string(bytes_max) + " bytes";
    if (static_cast<std::size_t>(status.st_size) > bytes_max) return file_failed(file, too_large);
    if (is_secret)
        if (const auto good = check_secrecy(file, status, reader); !good)
            return tl::unexpected(good.error());
    if (const std::string why = place->fault(opened); !why.empty()) return file_failed(file, why);
    std::string content(bytes_max + 1, '\0');
    std::size_t size = 0;
    while (size < content.size()) {
        const ssize_t got = read(opened.get(), content.data() + size, content.size() - size);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return file_failed(file, std::strerror(errno));
        if (got == 0) break;
        size += static_cast<std::size_t>(got);
    }
    if (size > bytes_max) return file_failed(file, too_large);
    content.resize(size);
    return content;
}

/// A new file beside its final place. It is removed again unless it is put there.
class StagedFile {
public:
    static Result<StagedFile> write(const NewFile& file);
    StagedFile(StagedFile&& other) noexcept
        : place_(std::move(other.place_)),
          name_(std::exchange(other.name_, {})),
          is_first_(other.is_first_) {}
    StagedFile(const StagedFile&) = delete;
    ~StagedFile() {
        if (!name_.empty()) unlinkat(place_.folder(), name_.c_str(), 0);
    }
    Result<void> put() {
        if (renameat2(place_.folder(), name_.c_str(), place_.folder(), place_.name().c_str(),
                      is_first_ ? RENAME_NOREPLACE : 0) != 0)
            return file_failed(place_.path(), std::strerror(errno));
        name_.clear();
        return {};
    }
    [[nodiscard]] const FilePlace& place() const { return place_; }

private:
    explicit StagedFile(const NewFile& file) : place_(file.place), is_first_(file.is_first) {}
    Result<void> fill(int made, const std::string& content) const;

    FilePlace place_;
    std::string name_;
    bool is_first_;
};

Result<StagedFile> StagedFile::write(const NewFile& file) {
    StagedFile staged(file);
    const FilePlace& place = file.place;
    std::uint64_t random = 0;
    if (getrandom(&random, sizeof random, 0) < 0)
        return file_failed(place.path(), std::strerror(errno));
    const std::string name = place.name() + "." + std::to_string(random);
    const Fd made(
        openat(place.folder(), name.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600));
    if (made.get() < 0)
        return file_failed(
            place.path(),
            std::string(std::strerror(errno)) +
                (errno == EACCES ? "; run this command as root, or as a user who may write in " +
                                       place.path().parent_path().string()
                                 : ""));
    staged.name_ = name;
    if (auto filled = staged.fill(made.get(), file.content); !filled)
        return tl::unexpected(filled.error());
    return staged;
}

Result<void> StagedFile::fill(int made, const std::string& content) const {
    const fs::path& file = place_.path();
    struct stat old {};
    const bool replaces =
        fstatat(place_.folder(), place_.name().c_str(), &old, AT_SYMLINK_NOFOLLOW) == 0 &&
        S_ISREG(old.st_mode);
    if (replaces && (old.st_uid != geteuid() || old.st_gid != getegid()) &&
        fchown(made, old.st_uid, old.st_gid) != 0 && old.st_uid != geteuid())
        return file_failed(file, "its owner cannot be kept: " + std::string(std::strerror(errno)) +
                                     "; run this command as root");
    // After fchown(), which may take bits away.
    if (fchmod(made, replaces ? old.st_mode & 0777U : 0600U) != 0)
        return file_failed(file, std::strerror(errno));
    for (std::string_view left = content; !left.empty();) {
        const ssize_t written = ::write(made, left.data(), left.size());
        if (written < 0 && errno != EINTR) return file_failed(file, std::strerror(errno));
        if (written > 0) left.remove_prefix(static_cast<std::size_t>(written));
    }
    return fsync(made) == 0 ? Result<void>() : file_failed(file, std::strerror(errno));
}

}  // namespace

Result<std::string> read_regular_file(const fs::path& file, std::size_t bytes_max,
                                      const std::string& harm) {
    return read_whole(FilePlace::find(file, harm), file, bytes_max, Reader::daemon, false);
}

Result<std::string> read_secret_file(const fs::path& file, std::size_t bytes_max, Reader reader) {
    const std::string harm = reader == Reader::daemon ? "let in whom they like" : "";
    return read_whole(FilePlace::find(file, harm), file, bytes_max, reader, true);
}

Result<std::string> read_regular_file(const FilePlace& place, std::size_t bytes_max) {
    return read_whole(place, place.path(), bytes_max, Reader::command, false);
}

Result<std::string> read_secret_file(const FilePlace& place, std::size_t bytes_max, Reader reader) {
    return read_whole(place, place.path(), bytes_max, reader, true);
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
    for (const StagedFile& file : staged) (void)fsync(file.place().open_folder().get());
    return {};
}

}  // namespace raynest::server
