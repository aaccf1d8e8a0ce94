#include "client/ssh_tunnel.h"

#include "client/interrupt.h"

#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <regex>
#include <thread>
#include <vector>

namespace raynest::client {
namespace {

using Clock = std::chrono::steady_clock;
namespace fs = std::filesystem;

/// Long enough to type a password.
constexpr std::chrono::seconds start_time{60};
constexpr std::chrono::milliseconds look_time{10};

}  // namespace

Result<SshTunnel> SshTunnel::open(const std::string& uri) {
    // The host must not begin with '-': ssh would read it as an option.
    static const std::regex form("ssh://([A-Za-z0-9_][A-Za-z0-9_.@-]*)(?::([0-9]{1,5}))?(/[^:]*)?");
    std::smatch parts;
    if (!std::regex_match(uri, parts, form))
        return fail(Exit::usage, "'" + uri + "' is not ssh://[USER@]HOST[:PORT][/PATH of a socket]");
    SshTunnel tunnel;
    std::string pattern = "/tmp/raynest-XXXXXX";
    if (::mkdtemp(pattern.data()) == nullptr)
        return fail(Exit::cannot_connect, "cannot make a folder in /tmp: " + std::string(std::strerror(errno)));
    tunnel.folder_ = pattern;
    const std::string remote = parts[3].length() > 1 ? parts[3].str() : "/run/raynest/socket";
    std::vector<std::string> words = {"ssh", "-N", "-T", "-o", "ExitOnForwardFailure=yes",
                                      "-o", "ServerAliveInterval=10", "-L",
                                      (tunnel.folder_ / "socket").string() + ":" + remote};
    if (parts[2].matched) words.insert(words.end(), {"-p", parts[2].str()});
    words.insert(words.end(), {"--", parts[1].str()});
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    if (const int why = ::posix_spawnp(&tunnel.process_, "ssh", nullptr, nullptr, arguments.data(), environ); why != 0) {
        tunnel.process_ = -1;
        return fail(Exit::cannot_connect, "cannot start ssh: " + std::string(std::strerror(why)));
    }
    const Clock::time_point end = Clock::now() + start_time;
    std::error_code ignored;
    while (!fs::exists(tunnel.folder_ / "socket", ignored)) {
        if (interrupted()) return fail(Exit::interrupted, "interrupted");
        int status = 0;
        if (::waitpid(tunnel.process_, &status, WNOHANG) == tunnel.process_) {
            tunnel.process_ = -1;
            return fail(Exit::cannot_connect, "ssh to " + parts[1].str() + " failed; its reason is above");
        }
        if (Clock::now() > end)
            return fail(Exit::cannot_connect, "ssh to " + parts[1].str() + " did not connect within 60 s");
        std::this_thread::sleep_for(look_time);
    }
    return tunnel;
}

SshTunnel::~SshTunnel() {
    if (process_ > 0) {
        (void)::kill(process_, SIGTERM);
        (void)::waitpid(process_, nullptr, 0);
    }
    std::error_code ignored;
    if (!folder_.empty()) fs::remove_all(folder_, ignored);
}

}  // namespace raynest::client
