#include "server/store/source_root.h"

#include "engine/system/child_process.h"
#include "protocol/text.h"

#include <fcntl.h>
#include <linux/openat2.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <iterator>
#include <utility>

namespace raynest::server {
namespace {

/// Opens a path part by part and follows no link, where openat2() is taken away: systemd's
/// RestrictSUIDSGID= does so with ENOSYS, because it cannot look into the call's structure.
Fd open_by_parts(int folder, const std::filesystem::path& path, int flags) {
    Fd at(fcntl(folder, F_DUPFD_CLOEXEC, 0));
    const std::filesystem::path plain = path.lexically_normal();
    for (auto part = plain.begin(); part != plain.end(); ++part) {
        const bool is_last = std::next(part) == plain.end();
        const int inner = O_PATH | O_DIRECTORY | O_CLOEXEC;
        if (*part == "..") {
            errno = EXDEV;
            return Fd();
        }
        at = Fd(openat(at.get(), part->c_str(), (is_last ? flags : inner) | O_NOFOLLOW));
        if (at.get() < 0) break;
    }
    return at;
}

Fd open_beneath(int folder, const std::string& path, std::uint64_t flags) {
    open_how how{};
    how.flags = flags;
    how.resolve = RESOLVE_BENEATH | RESOLVE_NO_MAGICLINKS;
    Fd opened(static_cast<int>(syscall(SYS_openat2, folder, path.c_str(), &how, sizeof how)));
    if (opened.get() >= 0 || errno != ENOSYS) return opened;
    return open_by_parts(folder, path, static_cast<int>(flags));
}

tl::unexpected<Error> cannot_open(const std::string& name) {
    const int error = errno;
    const bool scarce = error == EMFILE || error == ENFILE;
    std::string why = system_says(error);
    if (error == EXDEV)
        why = "link leaves the folder; only relative links that end inside it are followed";
    if (error == ELOOP)
        why = "links lead in a circle, or are not followed here (RestrictSUIDSGID= of the unit)";
    return fail(scarce ? ErrorCode::io_failed : ErrorCode::scene_invalid,
                "cannot open root:" + name + ": " + why);
}

}  // namespace

Result<std::optional<SourceFile>> read_under_root(const std::filesystem::path& root,
                                                  const std::filesystem::path& folder,
                                                  const std::string& name, std::uint64_t bytes_max,
                                                  const LoadMemory& memory) {
    const std::string shown = (folder / name).string();
    if (root.empty())
        return fail(ErrorCode::scene_unsupported,
                    "root:" + shown + " needs a daemon that was started with --scene-root DIR");
    if (name.empty())
        return fail(ErrorCode::scene_invalid,
                    "root:" + shown +
                        " names no file; write root:PATH, the path of a file below "
                        "--scene-root");
    for (const auto& [path, place] : {std::pair(folder, "--scene-root"),
                                      std::pair(std::filesystem::path(name), "the scene's folder")})
        if (const auto plain = path.lexically_normal(); !plain.empty() && *plain.begin() == "..")
            return fail(ErrorCode::scene_invalid,
                        "cannot open root:" + shown + ": the path leaves " + place);
    if (shown.front() == '/' || shown.find('\0') != std::string::npos)
        return fail(ErrorCode::scene_invalid,
                    "root:PATH takes the path of a file below --scene-root, without a leading /");

    constexpr std::uint64_t folder_flags = O_PATH | O_DIRECTORY | O_CLOEXEC;
    const Fd top(open(root.c_str(), folder_flags));
    const Fd inside = open_beneath(top.get(), folder.empty() ? "." : folder.string(), folder_flags);
    const Fd file = inside.get() < 0 ? Fd()
                                     : open_beneath(inside.get(), name,
                                                    O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY);
    if (file.get() < 0 && (errno == ENOENT || errno == ENOTDIR)) return std::nullopt;
    if (file.get() < 0) return cannot_open(shown);
    struct stat status {};
    if (fstat(file.get(), &status) != 0 || !S_ISREG(status.st_mode))
        return fail(ErrorCode::scene_invalid, "root:" + shown + " is not a regular file");
    const auto size = static_cast<std::uint64_t>(status.st_size);
    if (size > bytes_max)
        return fail(ErrorCode::limit_exceeded, "root:" + shown + " has " + std::to_string(size) +
                                                   " bytes, the limit is " +
                                                   std::to_string(bytes_max));

    auto lease = memory.budget.reserve(size, memory.principal, Use::lasting);
    if (!lease)
        return fail(ErrorCode::out_of_memory,
                    "root:" + shown + " takes " + protocol::bytes_text(size) +
                        " of raynestd's --memory, more than " + memory.principal + " may take now");

    // Read only the size that was checked, even if the file grows; fail if it shrinks.
    SourceFile result{name, std::vector<std::byte>(size), std::move(*lease)};
    std::size_t done = 0;
    while (done < result.bytes.size()) {
        const ssize_t got =
            read(file.get(), result.bytes.data() + done, result.bytes.size() - done);
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0) return fail(ErrorCode::io_failed, "cannot read root:" + name + " to its end");
        done += static_cast<std::size_t>(got);
    }
    return std::optional(std::move(result));
}

}  // namespace raynest::server
