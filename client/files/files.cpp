#include "client/files/files.h"

#include "client/ground/descriptor.h"
#include "client/ground/interrupt.h"

#include <fcntl.h>
#include <linux/openat2.h>
#include <poll.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <new>
#include <utility>

namespace raynest::client {
namespace {

// O_NONBLOCK: a pipe without a writer opens at once.
constexpr int read_flags = O_RDONLY | O_NONBLOCK | O_CLOEXEC | O_NOCTTY;

/// Longest wait between two checks for Ctrl-C.
constexpr int look_ms = 200;
/// Bytes of a file read between two checks for Ctrl-C.
constexpr std::size_t piece_bytes = 64 << 20;
/// First size of the buffer for a pipe; it doubles as more bytes come.
constexpr std::size_t first_bytes = 64 << 10;

tl::unexpected<Failure> refuse(const std::string& name, const std::string& why) {
    return fail(Exit::invalid, name + ": " + why);
}

tl::unexpected<Failure> no_memory(const std::string& name, std::uint64_t bytes) {
    return fail(Exit::failed, name + ": no memory for its " + std::to_string(bytes) + " bytes");
}

Result<protocol::Buffer> read_all(const Descriptor& file, const std::string& name,
                                  std::uint64_t bytes_max) {
    struct stat status = {};
    if (fstat(file.number(), &status) != 0) return refuse(name, std::strerror(errno));
    if (!S_ISREG(status.st_mode)) return refuse(name, "is not a regular file");
    const auto size = static_cast<std::uint64_t>(status.st_size);
    if (size > bytes_max)
        return refuse(name, "has " + std::to_string(size) + " bytes; at most " +
                                std::to_string(bytes_max) + " are taken");
    try {
        protocol::Buffer bytes(size);
        for (std::size_t done = 0; done < size;) {
            if (interrupted()) return fail(Exit::interrupted, "interrupted");
            const ssize_t count =
                ::read(file.number(), bytes.data() + done, std::min(size - done, piece_bytes));
            if (count < 0 && errno == EINTR) continue;
            if (count < 0) return refuse(name, std::strerror(errno));
            if (count == 0) return refuse(name, "became shorter while it was read");
            done += static_cast<std::size_t>(count);
        }
        return bytes;
    } catch (const std::bad_alloc&) {
        return no_memory(name, size);
    }
}

/// Reads the next bytes of a pipe or device; 0 at its end. Waits for a pipe that nobody has opened
/// for writing yet.
Result<std::size_t> read_some(const Descriptor& file, const std::string& name,
                              std::span<std::byte> room) {
    while (true) {
        // A signal that comes between this test and poll() is missed. The short wait bounds the
        // delay.
        if (interrupted()) return fail(Exit::interrupted, "interrupted");
        pollfd waiting{file.number(), POLLIN, 0};
        if (::poll(&waiting, 1, look_ms) <= 0) continue;
        const ssize_t count = ::read(file.number(), room.data(), room.size());
        if (count >= 0) return static_cast<std::size_t>(count);
        if (errno != EINTR && errno != EAGAIN) return refuse(name, std::strerror(errno));
    }
}

/// Reads everything until the end.
Result<protocol::Buffer> read_stream(const Descriptor& file, const std::string& name,
                                     std::uint64_t bytes_max, const CheckBegin& check) {
    std::size_t done = 0;
    bool checked = !check;
    try {
        protocol::Buffer bytes(first_bytes);
        while (true) {
            const auto count = read_some(file, name, bytes.span().subspan(done));
            if (!count) return tl::unexpected<Failure>(count.error());
            done += *count;
            if (!checked) {
                const auto most = check(bytes.span().first(done));
                if (!most) return tl::unexpected<Failure>(most.error());
                checked = most->has_value();
                bytes_max = std::min(bytes_max, most->value_or(bytes_max));
            }
            if (done > bytes_max)
                return refuse(name, "goes on after " + std::to_string(bytes_max) +
                                        " bytes; more are not taken");
            if (*count != 0 && done < bytes.size()) continue;
            protocol::Buffer moved(*count == 0 ? done : 2 * done);
            std::copy_n(bytes.data(), done, moved.data());
            bytes = std::move(moved);
            if (*count == 0) return bytes;
        }
    } catch (const std::bad_alloc&) {
        return no_memory(name, done);
    }
}

}  // namespace

std::string shown_name(const std::string& path) {
    return path == standard_stream ? "stdin" : path;
}

std::string extension_of(const std::string& path) {
    const std::size_t dot = path.rfind('.');
    if (dot == std::string::npos || path.find('/', dot) != std::string::npos) return "";
    std::string extension = path.substr(dot);
    for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    return extension;
}

bool is_device(const std::string& path) {
    struct stat status = {};
    return ::stat(path.c_str(), &status) == 0 && !S_ISREG(status.st_mode) &&
           !S_ISDIR(status.st_mode);
}

Result<protocol::Buffer> read_file(const std::string& path, std::uint64_t bytes_max,
                                   const CheckBegin& check) {
    // Use descriptor 0: stdin may be a socket, which cannot be opened by a path.
    const bool standard = path == standard_stream || path == "/dev/stdin";
    const std::string name = shown_name(path);
    const Descriptor file(standard ? ::fcntl(STDIN_FILENO, F_DUPFD_CLOEXEC, 0)
                                   : ::open(path.c_str(), read_flags));
    if (!file) return refuse(name, std::strerror(errno));
    struct stat status = {};
    if (::fstat(file.number(), &status) != 0) return refuse(name, std::strerror(errno));
    if (S_ISDIR(status.st_mode)) return refuse(name, "is a folder");
    if (S_ISREG(status.st_mode) && !standard) return read_all(file, name, bytes_max);
    return read_stream(file, name, std::min(bytes_max, piped_bytes_max), check);
}

namespace {

/// For kernels without openat2 (before 5.6), and for names without links: none is followed.
int open_without_links(int folder, const std::string& name) {
    Descriptor at(::dup(folder));
    for (std::size_t begin = 0;;) {
        const std::size_t end = std::min(name.find('/', begin), name.size());
        const std::string component = name.substr(begin, end - begin);
        errno = EXDEV;
        if (component.empty() || component == "..") return -1;
        const bool last = end == name.size();
        const int flags = O_NOFOLLOW | (last ? read_flags : O_PATH | O_DIRECTORY | O_CLOEXEC);
        const int next = ::openat(at.number(), component.c_str(), flags);
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

/// The same through links that leave the folder on their way, as absolute ones do, and end inside.
int open_returning(const std::string& folder, int at, const std::string& name) {
    namespace fs = std::filesystem;
    std::error_code unknown;
    const fs::path base = fs::canonical(folder, unknown);
    const fs::path end = unknown ? fs::path() : fs::canonical(base / name, unknown);
    const std::string inside = unknown ? ".." : end.lexically_relative(base).string();
    errno = EXDEV;
    if (inside == ".." || inside.starts_with("../")) return -1;
    return open_without_links(at, inside);
}

}  // namespace

Result<std::optional<protocol::Buffer>> read_file_beneath(const std::string& folder,
                                                          const std::string& name,
                                                          std::uint64_t bytes_max) {
    const std::string base = folder.empty() ? "." : folder;
    const Descriptor at(::open(base.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC));
    if (!at) return refuse(folder, std::strerror(errno));
    if (name.find('\0') != std::string::npos) return refuse(name, "is not the name of a file");
    int opened = open_beneath(at.number(), name);
    if (opened < 0 && errno == EXDEV) opened = open_returning(base, at.number(), name);
    const Descriptor file(opened);
    if (file) {
        auto bytes = read_all(file, name, bytes_max);
        if (!bytes) return tl::unexpected<Failure>(bytes.error());
        return std::optional(std::move(*bytes));
    }
    if (errno == ENOENT || errno == ENOTDIR) return std::nullopt;
    if (errno == EXDEV)
        return refuse(name, "link leaves the folder; only links that end inside it are followed");
    return refuse(name, errno == ELOOP ? "links lead in a circle" : std::strerror(errno));
}

}  // namespace raynest::client
