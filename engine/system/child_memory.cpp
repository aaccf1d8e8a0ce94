#include "engine/system/child_memory.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <string_view>

namespace raynest {
namespace {

constexpr std::uint64_t block_bytes = 512;  // the unit of st_blocks
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
// The sanitizer's own tables take at least this.
constexpr std::uint64_t checks_bytes = 32 << 20;
#else
constexpr std::uint64_t checks_bytes = 0;
#endif

/// Returns the number in the line "KEY:  123" of a status file; 0 if it has none.
std::uint64_t number_in(std::string_view status, std::string_view key) {
    const std::size_t line = status.find(key);
    if (line == std::string_view::npos) return 0;
    const std::size_t digits = status.find_first_of("0123456789", line + key.size());
    if (digits == std::string_view::npos) return 0;
    std::uint64_t number = 0;
    std::from_chars(status.data() + digits, status.data() + status.size(), number);
    return number;
}

/// Returns the bytes in the line "KEY:  123 kB".
std::uint64_t bytes_in(std::string_view status, std::string_view key) {
    return number_in(status, key) << 10;
}

using Text = std::array<char, 4096>;

/// Returns the content of an open status file; empty on failure.
std::string_view read_status(const Fd& file, Text& text) {
    const ssize_t size = ::pread(file.get(), text.data(), text.size(), 0);
    return {text.data(), static_cast<std::size_t>(std::max<ssize_t>(size, 0))};
}

}  // namespace

ChildMemory::ChildMemory(pid_t child, const Fd& written, std::uint64_t shared_bytes)
    : status_(::open(fmt::format("/proc/{}/status", child).c_str(), O_RDONLY | O_CLOEXEC)),
      written_(written),
      shared_bytes_(shared_bytes) {}

std::uint64_t ChildMemory::bytes() const {
    Text text;
    const std::string_view status = read_status(status_, text);
    const std::uint64_t shared = bytes_in(status, "\nRssShmem:");
    struct stat file {};
    const bool written = ::fstat(written_.get(), &file) == 0;
    const std::uint64_t own = bytes_in(status, "\nRssAnon:");
    return own - std::min(own, checks_bytes) + bytes_in(status, "\nVmSwap:") +
           bytes_in(status, "\nVmPTE:") + shared - std::min(shared, shared_bytes_) +
           (written ? static_cast<std::uint64_t>(file.st_blocks) * block_bytes : 0);
}

std::uint64_t ChildMemory::threads() const {
    Text text;
    return number_in(read_status(status_, text), "\nThreads:");
}

}  // namespace raynest
