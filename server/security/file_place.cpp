#include "server/security/file_place.h"

#include <fcntl.h>
#include <grp.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <cstring>
#include <string_view>
#include <system_error>
#include <vector>

namespace raynest::server {
namespace {

namespace fs = std::filesystem;

/// As many as Linux follows itself.
constexpr std::size_t links_max = 40;

/// Returns the target of a symbolic link that was opened with O_PATH; empty on failure.
fs::path target_of(const Fd& link) {
    std::array<char, PATH_MAX> text{};
    const ssize_t size = readlinkat(link.get(), "", text.data(), text.size());
    return std::string(text.data(), size < 0 ? 0 : static_cast<std::size_t>(size));
}

}  // namespace

bool is_everybodys(gid_t group) {
    std::array<char, 4096> text{};
    ::group entry{};
    ::group* found = nullptr;
    (void)getgrgid_r(group, &entry, text.data(), text.size(), &found);
    constexpr std::array<std::string_view, 3> names = {"users", "nogroup", "nobody"};
    return found != nullptr && std::ranges::find(names, found->gr_name) != names.end();
}

std::string others_fault(const fs::path& path, const std::string& harm) {
    const auto is_trusted = [](const struct stat& status) {
        return status.st_uid == geteuid() || status.st_uid == 0;
    };
    struct stat link {};
    struct stat status {};
    if (lstat(path.c_str(), &link) != 0 || stat(path.c_str(), &status) != 0) return "";
    // Nobody writes through a mount that is read-only, as Kubernetes makes those of ConfigMaps, which
    // have mode 777, and Docker those of another user's files.
    struct statvfs mount {};
    if (statvfs(path.c_str(), &mount) == 0 && (mount.f_flag & ST_RDONLY) != 0) return "";
    const std::string name = path.string();
    const bool is_folder = S_ISDIR(status.st_mode);
    if (!is_trusted(link) || !is_trusted(status))
        return name + " belongs to the user " +
               std::to_string((is_trusted(status) ? link : status).st_uid) + ", who could " + harm +
               "; run the daemon as that user, or give it a " + (is_folder ? "folder" : "file") +
               " of its own";
    // Where each user has a group, new files may be written by it.
    const bool own_group = status.st_gid == getegid() && !is_everybodys(status.st_gid);
    if ((status.st_mode & (own_group ? 002U : 022U)) == 0) return "";
    return "other users may write in " + name + " and " + harm + "; chmod " +
           (is_folder ? "700 " : "go-w ") + name;
}

std::string place_fault(const fs::path& path, const std::string& harm) {
    std::error_code ignored;
    const fs::path target = fs::canonical(path, ignored);
    for (const fs::path& place : {fs::absolute(path, ignored).lexically_normal(), target}) {
        if (place.empty()) continue;
        if (std::string why = others_fault(place, harm); !why.empty()) return why;
        // In a folder such as /tmp, everybody may only take away what is theirs.
        struct stat folder {};
        const fs::path parent = place.parent_path();
        const bool is_sticky =
            stat(parent.c_str(), &folder) == 0 && (folder.st_mode & S_ISVTX) != 0;
        if (is_sticky && (folder.st_uid == 0 || folder.st_uid == geteuid())) continue;
        if (std::string why = others_fault(parent, harm); !why.empty()) return why;
    }
    return "";
}

tl::unexpected<Error> file_failed(const fs::path& file, const std::string& why) {
    return fail(ErrorCode::io_failed, file.string() + ": " + why);
}

bool FilePlace::enter(const fs::path& path) {
    const std::string parent = path.has_parent_path() ? path.parent_path().string() : ".";
    const int base = folder_ == nullptr ? AT_FDCWD : folder_->get();
    Fd opened(openat(base, parent.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC));
    if (opened.get() < 0) return false;
    folder_ = std::make_shared<const Fd>(std::move(opened));
    path_ = (path_.parent_path() / path).lexically_normal();
    name_ = path.filename().string();
    return true;
}

Result<FilePlace> FilePlace::find(const fs::path& path) {
    const auto leads_nowhere = [&](int error) {
        return file_failed(path, "what this link leads to: " + std::string(std::strerror(error)) +
                                     "; make it, or remove the link");
    };
    FilePlace place;
    if (!place.enter(path)) return file_failed(path.parent_path(), std::strerror(errno));
    std::vector<uid_t> owners;  // owners of the links
    for (;;) {
        if (place.name_.empty() || place.name_ == "." || place.name_ == "..")
            return file_failed(path, "it is a folder; name a file in it");
        const Fd opened(
            openat(place.folder(), place.name_.c_str(), O_PATH | O_NOFOLLOW | O_CLOEXEC));
        struct stat status {};
        const bool is_there = opened.get() >= 0 && fstat(opened.get(), &status) == 0;
        if (!is_there && !owners.empty()) return leads_nowhere(errno);
        if (!is_there && errno != ENOENT) return file_failed(path, std::strerror(errno));
        if (!is_there || !S_ISLNK(status.st_mode)) {
            const auto is_trusted = [&](uid_t owner) {
                return owner == 0 || owner == geteuid() || owner == status.st_uid;
            };
            if (std::ranges::all_of(owners, is_trusted)) return place;
            return file_failed(
                path, "this link belongs to another user than its target; name the target");
        }
        if (owners.size() == links_max) return leads_nowhere(ELOOP);
        owners.push_back(status.st_uid);
        if (!place.enter(target_of(opened))) return leads_nowhere(errno);
    }
}

bool FilePlace::exists() const {
    return faccessat(folder(), name_.c_str(), F_OK, AT_SYMLINK_NOFOLLOW) == 0;
}

Fd FilePlace::open_folder() const {
    return Fd(openat(folder(), ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC));
}

}  // namespace raynest::server
