#include "client/files.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <new>
#include <string_view>
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
    const std::string temporary = path + ".part";
    const auto give_up = [&] {
        const std::string why = std::strerror(errno);
        ::unlink(temporary.c_str());
        return fail(Exit::failed, "cannot write " + path + ": " + why);
    };
    {
        const Descriptor file(
            ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666));
        if (!file) return give_up();
        while (!bytes.empty()) {
            const ssize_t count = ::write(file.get(), bytes.data(), bytes.size());
            if (count < 0 && errno == EINTR) continue;
            if (count < 0) return give_up();
            bytes = bytes.subspan(static_cast<std::size_t>(count));
        }
    }
    if (std::rename(temporary.c_str(), path.c_str()) != 0) return give_up();
    return {};
}

Result<void> check_writable(const std::string& path) {
    struct stat status = {};
    if (::stat(path.c_str(), &status) == 0 && S_ISDIR(status.st_mode))
        return fail(Exit::failed, "cannot write " + path + ": it is a directory");
    const std::size_t slash = path.rfind('/');
    const std::string folder = slash == std::string::npos ? "." : path.substr(0, slash + 1);
    if (::access(folder.c_str(), W_OK | X_OK) != 0)
        return fail(Exit::failed, "cannot write " + path + ": " + std::strerror(errno));
    return {};
}

}  // namespace raynest::client
