#include "client/files.h"

#include <fcntl.h>
#include <linux/openat2.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <new>
#include <system_error>
#include <utility>

namespace raynest::client {
namespace {

/// Closes on destruction.
class Descriptor {
public:
    explicit Descriptor(int value) : value_(value) {}
    Descriptor(Descriptor&& other) noexcept : value_(std::exchange(other.value_, -1)) {}
    Descriptor& operator=(Descriptor&& other) noexcept {
        std::swap(value_, other.value_);
        return *this;
    }
    Descriptor(const Descriptor&) = delete;
    Descriptor& operator=(const Descriptor&) = delete;
    ~Descriptor() {
        if (value_ >= 0) ::close(value_);
    }
    [[nodiscard]] int get() const { return value_; }
    [[nodiscard]] explicit operator bool() const { return value_ >= 0; }

private:
    int value_;
};

// O_NONBLOCK: a pipe without a writer opens at once, and is then refused.
constexpr int read_flags = O_RDONLY | O_NONBLOCK | O_CLOEXEC | O_NOCTTY;

tl::unexpected<Failure> refuse(const std::string& name, const std::string& why) {
    return fail(Exit::invalid, name + ": " + why);
}

Result<protocol::Buffer> read_all(const Descriptor& file, const std::string& name,
                                  std::uint64_t bytes_max) {
    struct stat status = {};
    if (fstat(file.get(), &status) != 0) return refuse(name, std::strerror(errno));
    if (!S_ISREG(status.st_mode)) return refuse(name, "is not a regular file");
    const auto size = static_cast<std::uint64_t>(status.st_size);
    if (size > bytes_max)
        return refuse(name, "has " + std::to_string(size) + " bytes; at most " +
                                std::to_string(bytes_max) + " are taken");
    try {
        protocol::Buffer bytes(size);
        for (std::size_t done = 0; done < size;) {
            const ssize_t count = ::read(file.get(), bytes.data() + done, size - done);
            if (count < 0 && errno == EINTR) continue;
            if (count < 0) return refuse(name, std::strerror(errno));
            if (count == 0) return refuse(name, "became shorter while it was read");
            done += static_cast<std::size_t>(count);
        }
        return bytes;
    } catch (const std::bad_alloc&) {
        return fail(Exit::failed, name + ": no memory for its " + std::to_string(size) + " bytes");
    }
}

/// Where a path leads: a link stays one, and its end is written.
struct Target {
    explicit Target(const std::string& name) : path(name) {
        struct stat status = {};
        if (::stat(name.c_str(), &status) != 0) return;
        whole = S_ISREG(status.st_mode);
        std::error_code unknown;
        const auto end = std::filesystem::canonical(name, unknown);
        if (!unknown) path = end.string();
    }
    std::string path;
    bool whole = true;  ///< replaced as a whole: no pipe and no device
};

}  // namespace

Result<protocol::Buffer> read_file(const std::string& path, std::uint64_t bytes_max) {
    const Descriptor file(::open(path.c_str(), read_flags));
    if (!file) return refuse(path, std::strerror(errno));
    return read_all(file, path, bytes_max);
}

namespace {

/// For kernels without openat2 (before 5.6): no link is followed at all.
int open_without_links(int folder, const std::string& name) {
    Descriptor at(::dup(folder));
    for (std::size_t begin = 0;;) {
        const std::size_t end = std::min(name.find('/', begin), name.size());
        const std::string component = name.substr(begin, end - begin);
        errno = EXDEV;
        if (component.empty() || component == "..") return -1;
        const bool last = end == name.size();
        const int flags = O_NOFOLLOW | (last ? read_flags : O_PATH | O_DIRECTORY | O_CLOEXEC);
        const int next = ::openat(at.get(), component.c_str(), flags);
        if (last || next < 0) return next;
        at = Descriptor(next);
        begin = end + 1;
    }
}

int open_beneath(int folder, const std::string& name) {
    open_how how{};
    how.flags = read_flags;
    how.resolve = RESOLVE_BENEATH | RESOLVE_NO_MAGICLINKS;
    const auto file =
        static_cast<int>(::syscall(SYS_openat2, folder, name.c_str(), &how, sizeof how));
    return file < 0 && errno == ENOSYS ? open_without_links(folder, name) : file;
}

}  // namespace

Result<std::optional<protocol::Buffer>> read_file_beneath(const std::string& folder,
                                                          const std::string& name,
                                                          std::uint64_t bytes_max) {
    const Descriptor at(
        ::open(folder.empty() ? "." : folder.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC));
    if (!at) return refuse(folder, std::strerror(errno));
    if (name.find('\0') != std::string::npos) return refuse(name, "is not the name of a file");
    const Descriptor file(open_beneath(at.get(), name));
    if (file) {
        auto bytes = read_all(file, name, bytes_max);
        if (!bytes) return tl::unexpected<Failure>(bytes.error());
        return std::optional(std::move(*bytes));
    }
    if (errno == ENOENT || errno == ENOTDIR) return std::nullopt;
    if (errno == EXDEV)
        return refuse(
            name, "link leaves the folder; only relative links that end inside it are followed");
    return refuse(name, errno == ELOOP ? "links lead in a circle" : std::strerror(errno));
}

Result<void> write_file(const std::string& path, std::span<const std::byte> bytes) {
    const Target target(path);
    const std::string temporary = target.whole ? target.path + ".part" : target.path;
    const auto give_up = [&] {
        const std::string why = std::strerror(errno);
        if (target.whole) ::unlink(temporary.c_str());
        return fail(Exit::failed, "cannot write " + path + ": " + why);
    };
    {
        const int create = target.whole ? O_CREAT | O_TRUNC : 0;
        const Descriptor file(::open(temporary.c_str(), O_WRONLY | create | O_CLOEXEC, 0666));
        if (!file) return give_up();
        while (!bytes.empty()) {
            const ssize_t count = ::write(file.get(), bytes.data(), bytes.size());
            if (count < 0 && errno == EINTR) continue;
            if (count < 0) return give_up();
            bytes = bytes.subspan(static_cast<std::size_t>(count));
        }
    }
    if (target.whole && std::rename(temporary.c_str(), target.path.c_str()) != 0) return give_up();
    return {};
}

Result<void> check_writable(const std::string& path) {
    struct stat status = {};
    if (::stat(path.c_str(), &status) == 0 && S_ISDIR(status.st_mode))
        return fail(Exit::failed, "cannot write " + path + ": it is a directory");
    const Target target(path);
    const std::size_t slash = target.path.rfind('/');
    const std::string folder = slash == std::string::npos ? "." : target.path.substr(0, slash + 1);
    const bool writable = target.whole ? ::access(folder.c_str(), W_OK | X_OK) == 0
                                       : ::access(target.path.c_str(), W_OK) == 0;
    if (!writable) return fail(Exit::failed, "cannot write " + path + ": " + std::strerror(errno));
    return {};
}

}  // namespace raynest::client
