// A private daemon for one command: `--local`.
#pragma once

#include "client/failure.h"

#include <sys/types.h>

#include <filesystem>
#include <string>
#include <utility>

namespace raynest::client {

/// A raynestd that listens on a Unix socket in a temporary folder, which only its user can open. It
/// ends with this object, and with this process whatever ends that.
class LocalDaemon {
public:
    /// Starts the raynestd beside this program, else the one on PATH, and waits until it serves
    /// requests. Exit code 3 where there is none or it does not start.
    static Result<LocalDaemon> start();
    LocalDaemon(LocalDaemon&& other) noexcept
        : process_(std::exchange(other.process_, -1)),
          folder_(std::exchange(other.folder_, {})) {}
    LocalDaemon& operator=(LocalDaemon&&) = delete;
    LocalDaemon(const LocalDaemon&) = delete;
    ~LocalDaemon();

    [[nodiscard]] std::string uri() const { return "unix:" + (folder_ / "socket").string(); }
    /// Removes the folder once the client is connected, so that nothing stays behind even where
    /// this process is killed. Nobody can connect after that.
    void hide();

private:
    LocalDaemon() = default;
    Result<void> make_folder();
    Result<void> run(const std::string& program);
    Result<void> await_ready();

    pid_t process_ = -1;
    std::filesystem::path folder_;
};

}  // namespace raynest::client
