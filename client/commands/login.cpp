// raynest login URI: keeps a token that the daemon accepts in hosts.toml, with copies of the
// certificates, or these alone.
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/net/hosts.h"
#include "client/output/output.h"

#include <termios.h>
#include <unistd.h>

#include <array>
#include <iostream>
#include <string>

namespace raynest::client {
namespace {

/// Keeps the token of a daemon, and copies of the certificates, in hosts.toml.
struct LoginOptions {
    std::string uri;
};

/// Hides what is typed while it lives.
class Hidden {
public:
    Hidden() : is_terminal_(::tcgetattr(STDIN_FILENO, &before_) == 0) {
        if (!is_terminal_) return;
        termios hidden = before_;
        hidden.c_lflag &= ~static_cast<tcflag_t>(ECHO);
        (void)::tcsetattr(STDIN_FILENO, TCSAFLUSH, &hidden);
    }
    ~Hidden() {
        if (!is_terminal_) return;
        (void)::tcsetattr(STDIN_FILENO, TCSAFLUSH, &before_);
        std::cerr << '\n';
    }
    Hidden(const Hidden&) = delete;
    [[nodiscard]] bool is_terminal() const { return is_terminal_; }

private:
    termios before_{};
    const bool is_terminal_;
};

/// Asks for the token on the terminal, without showing it, or reads it from stdin. Empty if there is none, which
/// `may_lack` allows.
Result<std::string> ask_token(const std::string& uri, bool may_lack) {
    const Hidden hidden;
    if (hidden.is_terminal())
        std::cerr << "Token for " << uri << (may_lack ? " (empty: the certificate alone): " : ": ")
                  << std::flush;
    constexpr std::size_t token_bytes_max = 4096;
    std::array<char, token_bytes_max + 1> line{};
    std::cin.getline(line.data(), line.size());
    if (std::cin.fail() && static_cast<std::size_t>(std::cin.gcount()) == token_bytes_max)
        return fail(Exit::usage, "what came is no token: it is longer than " +
                                     std::to_string(token_bytes_max) + " bytes");
    std::string token = line.data();
    while (!token.empty() && (token.back() == '\r' || token.back() == ' ')) token.pop_back();
    if (token.empty() && !may_lack)
        return fail(Exit::usage, "no token came; it is the last line of: raynestd token add NAME");
    return token;
}

}  // namespace

void declare(CommandLine& line, LoginOptions& login) {
    line.add_option("URI", login.uri,
                    "tls://HOST:PORT or another --server; the token is read from "
                    "the terminal or stdin")
        .required();
}

Result<void> run(Context& context, const LoginOptions& options) {
    const Access& access = context.access;
    if (auto kept = keep_host(
            options.uri, {access.token, access.tls.ca, access.tls.certificate, access.tls.key, {}});
        !kept)
        return kept;
    const Daemon& daemon = context.connection.daemon();
    if (context.json)
        print_json(Json{{"principal", daemon.principal}, {"role", daemon.role}});
    else
        std::cout << "logged in to " << options.uri << " as " << daemon.principal << " ("
                  << daemon.role << "); kept in " << hosts_file() << '\n';
    return {};
}

namespace {

class Login final : public CommandOf<LoginOptions> {
    [[nodiscard]] const std::string* uri() const override { return &options_.uri; }
    Result<void> identify(const std::string& uri, Access& access) const override {
        auto token = ask_token(uri, !access.tls.certificate.empty());
        if (!token) return tl::unexpected<Failure>(token.error());
        access.token = std::move(*token);
        return check_secrecy(uri, access.token);
    }
};

}  // namespace

std::unique_ptr<Command> make_login() {
    return std::make_unique<Login>();
}

}  // namespace raynest::client
