#include "server/security/file_place.h"

#include <fcntl.h>
#include <grp.h>
#include <pwd.h>
#include <sys/stat.h>
#include <sys/xattr.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <cstring>
#include <mutex>
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

/// True if nobody but root and this process's user is in this group, and this process is.
bool is_private(gid_t group) {
    // The list of users has one place in the process, and files are read on several threads.
    static std::mutex reading;
    const std::lock_guard lock(reading);
    std::vector<char> text(1 << 16), names(1 << 16);
    passwd entry{};
    passwd* user = nullptr;
    const auto is_other = [&] {
        return user == nullptr || (user->pw_uid != 0 && user->pw_uid != geteuid());
    };
    if (group != getegid() || is_everybodys(group)) return false;
    ::group members{};
    ::group* found = nullptr;
    if (getgrgid_r(group, &members, names.data(), names.size(), &found) == ERANGE) return false;
    for (char** name = found == nullptr ? nullptr : found->gr_mem; name && *name; ++name) {
        (void)getpwnam_r(*name, &entry, text.data(), text.size(), &user);
        if (is_other()) return false;
    }
    bool is_shared = false;
    setpwent();
    int ended = 0;
    while ((ended = getpwent_r(&entry, text.data(), text.size(), &user)) == 0)
        is_shared = is_shared || (user->pw_gid == group && is_other());
    is_shared = is_shared || ended != ENOENT;  // a row that is too long may be of anybody
    endpwent();
    return !is_shared;
}

/// True if an access list may give others a right that shows as one of the group.
bool has_access_list(const Fd& opened) {
    // A descriptor that was opened with O_PATH has no attributes itself.
    const std::string path = "/proc/self/fd/" + std::to_string(opened.get());
    return getxattr(path.c_str(), "system.posix_acl_access", nullptr, 0) >= 0 ||
           (errno != ENODATA && errno != ENOTSUP);
}

bool is_trusted(uid_t owner) {
    struct stat root {};
    return owner == 0 || owner == geteuid() || (stat("/", &root) == 0 && owner == root.st_uid);
}

/// As others_fault(), about what was opened. In a folder on the way to something that is asked, too,
/// everybody may write if they may only take away what is theirs, as in /tmp.
std::string opened_fault(const Fd& opened, const fs::path& path, const std::string& harm,
                         bool on_the_way = false) {
    struct stat status {};
    if (fstat(opened.get(), &status) != 0) return std::strerror(errno);
    const std::string name = path.string();
    const bool is_folder = S_ISDIR(status.st_mode);
    if (!is_trusted(status.st_uid))
        return name + " belongs to the user " + std::to_string(status.st_uid) + ", who could " +
               harm + "; run the daemon as that user, or give it a " +
               (is_folder ? "folder" : "file") + " of its own";
    const mode_t writers = status.st_mode & 022U;
    const bool is_sticky = on_the_way && (status.st_mode & S_ISVTX) != 0;
    if (writers == 0 || S_ISLNK(status.st_mode) || is_sticky) return "";
    const bool own_group = writers == S_IWGRP && is_private(status.st_gid);
    if (own_group && !has_access_list(opened)) return "";
    const char* const remedy = own_group            ? "setfacl -b "
                               : writers == S_IWGRP ? "chmod g-w "
                                                    : "chmod go-w ";
    return "other users may write in " + name + " and " + harm + "; " + remedy + name;
}

/// One walk from the root folder to what a path means.
struct Walk {
    Fd folder;              ///< where it ended, with the name
    Fd found;               ///< opened with O_PATH; empty if a file is missing
    struct stat status {};  ///< of `found`
    std::string name;
    fs::path path;              ///< behind all links
    std::vector<uid_t> owners;  ///< of the links

    /// Returns why it could not go on, or who could lead it elsewhere; empty at the end.
    std::string to(const fs::path& given, const std::string& harm);
};

std::string Walk::to(const fs::path& given, const std::string& harm) {
    std::vector<std::string> left;  // the next part is at the end
    const auto add = [&](const fs::path& more) {
        for (auto part = more.end(); part != more.begin();)
            if (--part; !part->empty() && *part != ".") left.push_back(part->string());
    };
    std::error_code ignored;
    add(fs::absolute(given, ignored));
    bool is_link = false;  // the path itself, not a folder on the way
    while (!left.empty()) {
        const std::string part = std::move(left.back());
        left.pop_back();
        const auto enter = [&](int more) {
            return Fd(openat(found.get(), part.c_str(), O_PATH | O_NOFOLLOW | O_CLOEXEC | more));
        };
        // O_DIRECTORY makes the system mount what it mounts on demand.
        Fd next = enter(left.empty() ? 0 : O_DIRECTORY);
        if (next.get() < 0 && errno == ENOTDIR) next = enter(0);
        int error = next.get() < 0 ? errno : 0;
        const bool is_missing = error == ENOENT && left.empty() && !is_link;
        status = {};
        if (error == 0 && fstat(next.get(), &status) != 0) error = errno;
        const fs::path there = part == ".." ? path.parent_path() : path / part;
        const bool is_passed = error == 0 && (!left.empty() || S_ISLNK(status.st_mode));
        if (is_passed && !harm.empty())
            if (std::string why = opened_fault(next, there, harm, true); !why.empty()) return why;
        if (error == 0 && S_ISLNK(status.st_mode)) {
            is_link = is_link || left.empty();
            owners.push_back(status.st_uid);
            const fs::path target = target_of(next);
            if (target.empty()) error = errno;
            if (owners.size() > links_max) error = ELOOP;
            add(target);
            if (error == 0) continue;
        }
        if (error != 0 && !is_missing)
            return (is_link ? "what this link leads to: " : "") +
                   std::string(std::strerror(error)) +
                   (error == EACCES ? "; let this user enter " + path.string()
                    : is_link       ? "; make it, or remove the link"
                                    : "");
        folder = std::move(found);
        found = std::move(next);
        path = there;
        name = part;
    }
    return "";
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
    for (const int itself : {O_NOFOLLOW, 0}) {
        const Fd opened(open(path.c_str(), O_PATH | O_CLOEXEC | itself));
        if (opened.get() < 0) return "";
        if (std::string why = opened_fault(opened, path, harm); !why.empty()) return why;
    }
    return "";
}

std::string place_fault(const fs::path& path, const std::string& harm) {
    Walk walk;
    std::string why = walk.to(path, harm);
    return why.empty() && walk.found.get() >= 0 ? opened_fault(walk.found, walk.path, harm) : why;
}

tl::unexpected<Error> file_failed(const fs::path& file, const std::string& why) {
    return fail(ErrorCode::io_failed, file.string() + ": " + why);
}

Result<FilePlace> FilePlace::find(const fs::path& path, const std::string& harm) {
    Walk walk;
    if (const std::string why = walk.to(path, harm); !why.empty()) return file_failed(path, why);
    if (S_ISDIR(walk.status.st_mode)) return file_failed(path, "it is a folder; name a file in it");
    const auto may_lead = [&](uid_t owner) {
        return is_trusted(owner) || owner == walk.status.st_uid;
    };
    if (!std::ranges::all_of(walk.owners, may_lead))
        return file_failed(path,
                           "this link belongs to another user than its target; name the target");
    FilePlace place;
    place.folder_ = std::make_shared<const Fd>(std::move(walk.folder));
    place.path_ = std::move(walk.path);
    place.name_ = std::move(walk.name);
    place.harm_ = harm;
    return place;
}

std::string FilePlace::fault(const Fd& opened) const {
    return harm_.empty() ? "" : opened_fault(opened, path_, harm_);
}

bool FilePlace::exists() const {
    return faccessat(folder(), name_.c_str(), F_OK, AT_SYMLINK_NOFOLLOW) == 0;
}

Fd FilePlace::open_folder() const {
    return Fd(openat(folder(), ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC));
}

}  // namespace raynest::server
