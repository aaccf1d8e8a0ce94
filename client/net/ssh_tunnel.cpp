#include "client/net/ssh_tunnel.h"

#include "client/ground/interrupt.h"
#include "client/net/temporary_folder.h"

#include <fcntl.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <regex>
#include <thread>
#include <utility>
#include <vector>

namespace raynest::client {
namespace {

using Clock = std::chrono::steady_clock;
namespace fs = std::filesystem;

/// Long enough to type a password.
constexpr std::chrono::seconds tunnel_start_time{60};

}  // namespace

Result<SshTunnel> SshTunnel::open(const std::string& uri) {
    // No part begins with '-', which ssh would read as an option, and nothing in the path is
    // expanded.
    static const std::regex form(
        "ssh://((?:[A-Za-z0-9_][A-Za-z0-9_.-]*@)?[A-Za-z0-9_][A-Za-z0-9_.-]*)(?::([0-9]{1,5}))?"
        "(/[^:$%\\\\[:cntrl:]]*)?");
    std::smatch parts;
    if (!std::regex_match(uri, parts, form))
        return fail(Exit::usage,
                    "'" + uri + "' is not ssh://[USER@]HOST[:PORT][/PATH of a socket]");
    const std::string host = parts[1].str();
    auto folder = TemporaryFolder::make();
    if (!folder) return tl::unexpected<Failure>(folder.error());
    const fs::path socket = folder->path() / "socket";
    const std::string remote = parts[3].length() > 1 ? parts[3].str() : "/run/raynest/socket";
    // -S none: a connection that other ssh programs share would outlive this one.
    std::vector<std::string> words = {"ssh",
                                      "-N",
                                      "-T",
                                      "-S",
                                      "none",
                                      "-o",
                                      "ExitOnForwardFailure=yes",
                                      "-o",
                                      "ServerAliveInterval=10",
                                      "-L",
                                      socket.string() + ":" + remote};
    if (parts[2].matched) words.insert(words.end(), {"-p", parts[2].str()});
    words.insert(words.end(), {"--", host});
    auto ssh = ChildProcess::start(std::move(words), ChildKind::asking);
    if (!ssh) return fail(Exit::cannot_connect, "cannot start ssh: " + ssh.error().message);
    SshTunnel tunnel(std::move(*ssh), host);

    const Clock::time_point end = Clock::now() + tunnel_start_time;
    std::error_code ignored;
    while (!fs::exists(socket, ignored)) {
        if (interrupted()) return fail(Exit::interrupted, "interrupted");
        if (tunnel.ssh_.has_ended()) return tl::unexpected<Failure>(tunnel.explain({}));
        if (Clock::now() > end)
            return fail(Exit::cannot_connect, "ssh to " + host + " did not connect within 60 s");
        std::this_thread::sleep_for(look_time);
    }
    std::this_thread::sleep_for(look_time);  // ssh listens a moment after the socket has its name
    tunnel.socket_ = Descriptor(::open(socket.c_str(), O_PATH | O_CLOEXEC));
    if (!tunnel.socket_)
        return fail(Exit::cannot_connect,
                    "cannot open " + socket.string() + ": " + std::strerror(errno));
    // Through /proc it can be connected to without a name: nothing is left behind, even by SIGKILL.
    tunnel.uri_ = "unix:/proc/self/fd/" + std::to_string(tunnel.socket_.number());
    return tunnel;
}

Failure SshTunnel::explain(Failure why) {
    const std::string line = ssh_.last_line();
    if (ssh_.has_ended())
        return failure(Exit::cannot_connect, "ssh to " + host_ + " failed: " +
                                                 (line.empty() ? "it gave no reason" : line));
    // ssh is there, and found no daemon's socket: one that restarts would be there.
    if (line.find("open failed") == std::string::npos) return why;
    return failure(Exit::cannot_connect,
                   "no daemon answers on " + host_ + " (ssh: " + line +
                       "); is raynestd running there, and may you open its socket?");
}

}  // namespace raynest::client
