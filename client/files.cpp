#include "client/files.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <new>
#include <string_view>
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

Result<protocol::Buffer> read_file_beneath(const std::string& folder, const std::string& name,
                                           std::uint64_t bytes_max) {
    Descriptor at(::open(folder.empty() ? "." : folder.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC));
    if (!at) return refuse(folder, std::strerror(errno));
    std::string_view rest = name;
    while (true) {
        const std::size_t slash = rest.find('/');
        const std::string component(rest.substr(0, slash));
        if (component.empty() || component == "." || component == ".." ||
            component.find('\0') != std::string::npos)
            return refuse(name, "is not a plain name beneath the scene's folder");
        const bool last = slash == std::string_view::npos;
        const int flags = O_NOFOLLOW | (last ? read_flags : O_PATH | O_DIRECTORY | O_CLOEXEC);
        Descriptor next(::openat(at.get(), component.c_str(), flags));
        if (!next && errno == ELOOP) return refuse(name, "goes through a symbolic link");
        if (!next) return refuse(name, std::strerror(errno));
        if (last) return read_all(next, name, bytes_max);
        at = std::move(next);
        rest.remove_prefix(slash + 1);
    }
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
