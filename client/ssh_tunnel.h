// The way to a daemon of another machine over the user's own ssh: `--server ssh://HOST`.
//
//   client ──► unix:FOLDER/socket ──ssh -L──► HOST ──► unix:/run/raynest/socket
#pragma once

#include "client/failure.h"

#include <sys/types.h>

#include <filesystem>
#include <string>
#include <utility>

namespace raynest::client {

/// An ssh that forwards a Unix socket in a temporary folder. It ends with this object.
class SshTunnel {
public:
    /// Starts ssh for ssh://[USER@]HOST[:PORT][/PATH], where PATH is the daemon's Unix socket
    /// (/run/raynest/socket), and waits until it forwards. ssh may ask for a password. Fails with
    /// exit code 3.
    static Result<SshTunnel> open(const std::string& uri);
    SshTunnel(SshTunnel&& other) noexcept
        : process_(std::exchange(other.process_, -1)),
          folder_(std::exchange(other.folder_, {})) {}
    SshTunnel& operator=(SshTunnel&&) = delete;
    SshTunnel(const SshTunnel&) = delete;
    ~SshTunnel();

    [[nodiscard]] std::string uri() const { return "unix:" + (folder_ / "socket").string(); }

private:
    SshTunnel() = default;

    pid_t process_ = -1;
    std::filesystem::path folder_;
};

}  // namespace raynest::client
