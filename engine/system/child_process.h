// Child processes: a program with a few inherited descriptors and null streams that ends when we
// do. We exchange data with it through memory files and sockets.
#pragma once

#include "engine/result.h"

#include <sys/types.h>

#include <cstddef>
#include <optional>
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
        share  ///< read and write; changes reach the file
    };
    Mapping() = default;
    /// Maps nothing if the file is empty or cannot be mapped.
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

/// Returns the system's text for an errno; with the remedy if file descriptors are used up.
[[nodiscard]] std::string system_says(int error);

/// Number of a child's first inherited descriptor.
inline constexpr int first_inherited_fd = 3;
inline constexpr int inherited_max = 4;

/// Duplicates the descriptor to a number above those of a child, close-on-exec. Empty if no
/// descriptor is left.
[[nodiscard]] Fd out_of_the_way(Fd fd);

/// Creates a memory file, close-on-exec, with a number above those of a child.
Result<Fd> create_memory_file(const char* name);

Result<void> write_all(int fd, const void* bytes, std::size_t size);

/// Starts `command` with /dev/null as its three streams and inherited[i] as descriptor 3 + i, in a
/// process group of its own. Pass at most inherited_max descriptors, each from out_of_the_way().
Result<pid_t> spawn_child(std::span<const std::string> command, std::span<const int> inherited);

/// Kills all processes of a child's group, and waits until the child has ended. Returns its status
/// as waitpid() gives it; nothing if it is no child of this process. Call it once for each child.
std::optional<int> end_group(pid_t child);

/// Called in the child: it dies with its parent and leaves no core file. False if the parent, whose
/// process id is `parent`, has already ended.
[[nodiscard]] bool bind_to_parent(pid_t parent);

}  // namespace raynest
