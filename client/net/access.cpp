#include "client/net/access.h"

#include "client/ground/text.h"
#include "client/net/address.h"
#include "client/net/hosts.h"

#include <algorithm>
#include <cstdlib>
#include <utility>

namespace raynest::client {
namespace {

constexpr std::size_t token_bytes_max = 256;

/// Takes blanks and line ends off both ends. Fails if the rest is not one word.
Result<std::string> to_token(const std::string& text, const std::string& where) {
    const std::size_t first = text.find_first_not_of(" \t\r\n");
    const std::size_t last = text.find_last_not_of(" \t\r\n");
    const std::string token =
        first == std::string::npos ? "" : text.substr(first, last - first + 1);
    const bool good =
        !token.empty() && token.size() <= token_bytes_max &&
        std::all_of(token.begin(), token.end(), [](char c) { return c > ' ' && c < 0x7F; });
    if (!good) return fail(Exit::usage, where + " holds no token: one word of printable letters");
    return token;
}

}  // namespace

Result<Access> find_access(const std::string& uri, const AccessOptions& options) {
    Access access{"", options.tls};
    const auto fall_back = [](std::string& value, const char* name) {
        if (value.empty()) value = environment_variable(name);
    };
    fall_back(access.tls.ca, "RAYNEST_CA");
    fall_back(access.tls.certificate, "RAYNEST_CERT");
    fall_back(access.tls.key, "RAYNEST_KEY");
    if (!options.token_file.empty()) {
        const auto content = read_secret(options.token_file, token_bytes_max);
        if (!content) return tl::unexpected<Failure>(content.error());
        auto token = to_token(*content, options.token_file);
        if (!token) return tl::unexpected<Failure>(token.error());
        access.token = std::move(*token);
    } else if (const std::string given = environment_variable("RAYNEST_TOKEN"); !given.empty()) {
        auto token = to_token(given, "RAYNEST_TOKEN");
        if (!token) return tl::unexpected<Failure>(token.error());
        access.token = std::move(*token);
    }
    auto kept = find_host(uri);
    if (!kept) return tl::unexpected<Failure>(kept.error());
    if (access.token.empty()) access.token = kept->token;
    if (access.tls.ca.empty()) access.tls.ca = kept->ca;
    if (access.tls.certificate.empty() && access.tls.key.empty()) {
        access.tls.certificate = kept->certificate;
        access.tls.key = kept->key;
    }
    access.warnings = std::move(kept->warnings);
    if (access.tls.certificate.empty() != access.tls.key.empty())
        return fail(Exit::usage, "--cert and --key belong together; give both");
    if (auto secret = check_secrecy(uri, access.token); !secret)
        return tl::unexpected<Failure>(secret.error());
    return access;
}

Result<void> check_secrecy(const std::string& uri, const std::string& token) {
    // Connection::open() refuses an address that cannot be split.
    const bool is_plain = uri.starts_with("tcp://") && authority_of(uri);
    if (token.empty() || !is_plain || is_this_machine(uri)) return {};
    return not_secret(uri);
}

tl::unexpected<Failure> not_secret(const std::string& uri) {
    return fail(Exit::usage, "a token is not sent to " + uri +
                                 ": tcp:// would show it to the network; use tls://, or unset "
                                 "RAYNEST_TOKEN");
}

}  // namespace raynest::client
