#include "server/store/source_root.h"

#include "engine/assets/child_process.h"
#include "protocol/text.h"

#include <fcntl.h>
#include <linux/openat2.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

namespace raynest::server {
namespace {

class Descriptor {
public:
    explicit Descriptor(int value) : value_(value) {}
    Descriptor(const Descriptor&) = delete;
    ~Descriptor() {
        if (value_ >= 0) close(value_);
    }
    [[nodiscard]] int value() const { return value_; }

private:
    int value_;
};

int open_beneath(int folder, const std::string& path, std::uint64_t flags) {
    open_how how{};
    how.flags = flags;
    how.resolve = RESOLVE_BENEATH | RESOLVE_NO_MAGICLINKS;
    return static_cast<int>(syscall(SYS_openat2, folder, path.c_str(), &how, sizeof how));
}

tl::unexpected<Error> cannot_open(const std::string& name) {
    const int error = errno;
    const bool scarce = error == EMFILE || error == ENFILE;
    std::string why = system_says(error);
    if (error == EXDEV)
        why = "link leaves the folder; only relative links that end inside it are followed";
    if (error == ELOOP) why = "links lead in a circle";
    return fail(scarce ? ErrorCode::io_failed : ErrorCode::scene_invalid,
                "cannot open root:" + name + ": " + why);
}

}  // namespace

Result<std::optional<SourceFile>> read_under_root(const std::filesystem::path& root,
                                                  const std::filesystem::path& folder,
                                                  const std::string& name, std::uint64_t bytes_max,
                                                  Budget& budget) {
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
    const Descriptor top(open(root.c_str(), folder_flags));
    const Descriptor inside(
        open_beneath(top.value(), folder.empty() ? "." : folder.string(), folder_flags));
    const Descriptor file(
        inside.value() < 0
            ? -1
            : open_beneath(inside.value(), name, O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY));
    if (file.value() < 0 && (errno == ENOENT || errno == ENOTDIR)) return std::nullopt;
    if (file.value() < 0) return cannot_open(shown);
    struct stat status {};
    if (fstat(file.value(), &status) != 0 || !S_ISREG(status.st_mode))
        return fail(ErrorCode::scene_invalid, "root:" + shown + " is not a regular file");
    const auto size = static_cast<std::uint64_t>(status.st_size);
    if (size > bytes_max)
        return fail(ErrorCode::limit_exceeded, "root:" + shown + " has " + std::to_string(size) +
                                                   " bytes, the limit is " +
                                                   std::to_string(bytes_max));

    auto lease = budget.reserve(size);
    if (!lease)
        return fail(ErrorCode::out_of_memory,
                    "root:" + shown + " has " + protocol::bytes_text(size) + ", " +
                        protocol::bytes_text(budget.limit() - budget.used()) +
                        " of raynestd's --memory are free");

    // Read only the size that was checked, even if the file grows; fail if it shrinks.
    SourceFile result{name, std::vector<std::byte>(size), std::move(*lease)};
    std::size_t done = 0;
    while (done < result.bytes.size()) {
        const ssize_t got =
            read(file.value(), result.bytes.data() + done, result.bytes.size() - done);
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0) return fail(ErrorCode::io_failed, "cannot read root:" + name + " to its end");
        done += static_cast<std::size_t>(got);
    }
    return std::optional(std::move(result));
}

}  // namespace raynest::server
