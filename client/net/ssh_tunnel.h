// The way to a daemon of another machine over the user's own ssh: `--server ssh://HOST`.
//
//   client ──► a Unix socket ──ssh -L──► HOST ──► unix:/run/raynest/socket
#pragma once

#include "client/ground/child_process.h"

#include <string>

namespace raynest::client {

/// An ssh that forwards a Unix socket. It ends with this object, and with this process whatever
/// ends that.
class SshTunnel {
public:
    /// Starts ssh for ssh://[USER@]HOST[:PORT][/PATH], where PATH is the daemon's Unix socket
    /// (/run/raynest/socket), and waits until it forwards. ssh may ask for a password. Fails with
    /// exit code 3. Call it from the main thread.
    static Result<SshTunnel> open(const std::string& uri);

    /// The address by which this process reaches the daemon.
    [[nodiscard]] const std::string& uri() const { return uri_; }
    /// Returns ssh's reason for a connection that failed, if ssh has one, else `why`.
    [[nodiscard]] Failure explain(Failure why);

private:
    SshTunnel(ChildProcess ssh, std::string host) : ssh_(std::move(ssh)), host_(std::move(host)) {}

    ChildProcess ssh_;
    std::string host_;
    std::string uri_;
    Descriptor socket_;  ///< holds the socket, whose name is removed once it is there
};

}  // namespace raynest::client
