// Processes of our own: a program with a few descriptors, null streams and nothing else of ours,
// that ends when we do. What they are told and tell goes through memory files and sockets.
#pragma once

#include "engine/result.h"

#include <sys/types.h>

#include <cstddef>
#include <span>
#include <string>
#include <utility>

namespace raynest {

/// A file descriptor that closes itself; -1 when empty.
class Fd {
public:
    explicit Fd(int fd = -1) : fd_(fd) {}
    Fd(Fd&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
    Fd& operator=(Fd&& other) noexcept {
        std::swap(fd_, other.fd_);
        return *this;
    }
    Fd(const Fd&) = delete;
    ~Fd();
    [[nodiscard]] int get() const { return fd_; }

private:
    int fd_;
};

/// A file's bytes, mapped while this lives; move-only.
class Mapping {
public:
    enum class Access {
        read,
        share  ///< to read and write, together with others who map the file
    };
    Mapping() = default;
    /// None where the file is empty or cannot be mapped.
    Mapping(const Fd& file, Access access);
    Mapping(Mapping&& other) noexcept : bytes_(std::exchange(other.bytes_, {})) {}
    Mapping& operator=(Mapping&& other) noexcept {
        std::swap(bytes_, other.bytes_);
        return *this;
    }
    Mapping(const Mapping&) = delete;
    ~Mapping();
    [[nodiscard]] std::span<std::byte> bytes() const { return bytes_; }

private:
    std::span<std::byte> bytes_;
};

/// What the system says of `error`, an errno; with the remedy where descriptors are used up.
[[nodiscard]] std::string system_says(int error);

/// What a child's first inherited descriptor is.
inline constexpr int first_inherited_fd = 3;
inline constexpr int inherited_max = 4;

/// The same file by a number that is above those of a child's, close-on-exec; empty where there is
/// none left.
[[nodiscard]] Fd out_of_the_way(Fd fd);

/// A memory file with close-on-exec, out of the way.
Result<Fd> create_memory_file(const char* name);

Result<void> write_all(int fd, const void* bytes, std::size_t size);

/// Starts `command`; its descriptors are /dev/null three times and inherited[i] as 3 + i. They are
/// out of the way, and at most inherited_max.
Result<pid_t> spawn_child(std::span<const std::string> command, std::span<const int> inherited);

/// In the child: it dies with its parent and leaves no core. False where the parent, of that
/// process id, has ended already.
[[nodiscard]] bool bind_to_parent(pid_t parent);

}  // namespace raynest
