// Programs that this one starts: ssh, a daemon of one command, a browser.
//
// They get /dev/null for stdin and stdout, a log of their own for stderr, no other descriptor and
// no RAYNEST_TOKEN. A caller who waits for the end of this program's output therefore waits for
// none of them.
#pragma once

#include "client/ground/descriptor.h"
#include "client/ground/failure.h"

#include <sys/types.h>

#include <chrono>
#include <string>
#include <utility>
#include <vector>

namespace raynest::client {

enum class ChildKind {
    /// Ends with this process, however that ends. Shares its terminal, to ask for a password, and
    /// ignores Ctrl-C, which is for this process.
    asking,
    /// Ends with this process, however that ends; knows nothing of its terminal.
    silent,
    /// Goes on after this process.
    independent,
};

class ChildProcess {
public:
    /// Starts `words`, whose first is looked up in PATH unless it has a slash. Call it from the
    /// main thread: a child that ends with this process ends with the thread that started it. Fails
    /// with exit code 3 and the reason alone.
    static Result<ChildProcess> start(std::vector<std::string> words, ChildKind kind);
    ChildProcess(ChildProcess&& other) noexcept
        : id_(std::exchange(other.id_, -1)),
          ends_(other.ends_),
          log_(std::move(other.log_)) {}
    ChildProcess& operator=(ChildProcess&&) = delete;
    ChildProcess(const ChildProcess&) = delete;
    /// Ends the child with SIGTERM, and after 5 s with SIGKILL, unless it is independent.
    ~ChildProcess();

    /// True once the child has ended; `status` is then as of waitpid().
    [[nodiscard]] bool has_ended(int* status = nullptr);
    /// Returns the last line that the child wrote to stderr, or "": always so of an independent
    /// one.
    [[nodiscard]] std::string last_line() const;

private:
    ChildProcess(ChildKind kind, Descriptor log)
        : ends_(kind != ChildKind::independent),
          log_(std::move(log)) {}

    pid_t id_ = -1;
    bool ends_;
    Descriptor log_;
};

/// Pause between two looks at a child that starts or ends.
inline constexpr std::chrono::milliseconds look_time{5};

}  // namespace raynest::client
