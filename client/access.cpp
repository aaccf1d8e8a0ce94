#include "client/access.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>

#define TOML_HEADER_ONLY 1
#define TOML_EXCEPTIONS 0
#include <toml++/toml.h>

namespace raynest::client {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t token_bytes_max = 256;
constexpr std::size_t hosts_bytes_max = 1 << 20;

std::string variable(const char* name) {
    const char* value = std::getenv(name);
    return value == nullptr ? "" : value;
}

/// Reads a file that only this user may read.
Result<std::string> read_secret(const std::string& file, std::size_t bytes_max) {
    struct stat status {};
    const int opened = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (opened < 0 || ::fstat(opened, &status) != 0) {
        const int why = errno;
        if (opened >= 0) ::close(opened);
        return fail(Exit::usage, "cannot read " + file + ": " + std::strerror(why));
    }
    const bool is_private = S_ISREG(status.st_mode) && (status.st_mode & 077U) == 0;
    std::string content(bytes_max + 1, '\0');
    const ssize_t got = is_private ? ::read(opened, content.data(), content.size()) : 0;
    ::close(opened);
    if (!is_private)
        return fail(Exit::usage, "other users may read " + file + ", and it holds a token; chmod 600 " + file);
    if (got < 0 || static_cast<std::size_t>(got) > bytes_max)
        return fail(Exit::usage, file + " is over " + std::to_string(bytes_max) + " bytes");
    content.resize(static_cast<std::size_t>(got));
    return content;
}

/// Takes blanks and line ends off both ends. Fails if the rest is not one word.
Result<std::string> to_token(const std::string& text, const std::string& where) {
    const std::size_t first = text.find_first_not_of(" \t\r\n");
    const std::size_t last = text.find_last_not_of(" \t\r\n");
    const std::string token = first == std::string::npos ? "" : text.substr(first, last - first + 1);
    const bool good = !token.empty() && token.size() <= token_bytes_max &&
                      std::all_of(token.begin(), token.end(), [](char c) { return c > ' ' && c < 0x7F; });
    if (!good) return fail(Exit::usage, where + " holds no token: one word of printable letters");
    return token;
}

/// True for a transport on which others may read along.
bool is_readable_by_others(const std::string& uri) {
    if (!uri.starts_with("tcp://")) return false;
    const std::string host = uri.substr(6, uri.rfind(':') - 6);
    return host != "localhost" && host != "[::1]" && !host.starts_with("127.");
}

Result<toml::table> read_hosts() {
    const std::string file = hosts_file();
    std::error_code error;
    if (!fs::exists(file, error)) return toml::table();
    const auto content = read_secret(file, hosts_bytes_max);
    if (!content) return tl::unexpected<Failure>(content.error());
    auto parsed = toml::parse(*content, file);
    if (!parsed) {
        std::ostringstream why;
        why << parsed.error().description() << " (" << parsed.error().source() << ")";
        return fail(Exit::usage, file + ": " + why.str());
    }
    return std::move(parsed).table();
}

void take(std::string& value, const toml::table* host, const char* key) {
    if (value.empty() && host != nullptr) value = (*host)[key].value_or(std::string());
}

}  // namespace

std::string hosts_file() {
    const std::string config = variable("XDG_CONFIG_HOME");
    if (config.starts_with('/')) return config + "/raynest/hosts.toml";
    return variable("HOME") + "/.config/raynest/hosts.toml";
}

Result<Access> find_access(const std::string& uri, const AccessOptions& options) {
    Access access{"", options.tls};
    const auto fall_back = [](std::string& value, const char* name) {
        if (value.empty()) value = variable(name);
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
    } else if (const std::string given = variable("RAYNEST_TOKEN"); !given.empty()) {
        auto token = to_token(given, "RAYNEST_TOKEN");
        if (!token) return tl::unexpected<Failure>(token.error());
        access.token = std::move(*token);
    }
    const auto hosts = read_hosts();
    if (!hosts) return tl::unexpected<Failure>(hosts.error());
    const toml::table* host = (*hosts)[uri].as_table();
    take(access.token, host, "token");
    take(access.tls.ca, host, "ca");
    take(access.tls.certificate, host, "cert");
    take(access.tls.key, host, "key");
    if (access.tls.certificate.empty() != access.tls.key.empty())
        return fail(Exit::usage, "--cert and --key belong together; give both");
    if (auto secret = check_secrecy(uri, access.token); !secret)
        return tl::unexpected<Failure>(secret.error());
    return access;
}

Result<void> check_secrecy(const std::string& uri, const std::string& token) {
    if (token.empty() || !is_readable_by_others(uri)) return {};
    return fail(Exit::usage, "a token is not sent to " + uri +
                                 ": tcp:// would show it to the network; use tls://, or unset "
                                 "RAYNEST_TOKEN");
}

Result<void> save_host(const std::string& uri, const Access& access) {
    auto hosts = read_hosts();
    if (!hosts) return tl::unexpected<Failure>(hosts.error());
    toml::table host;
    host.insert("token", access.token);
    const auto add = [&](const char* key, const std::string& file) {
        if (!file.empty()) host.insert(key, fs::absolute(file).string());
    };
    add("ca", access.tls.ca);
    add("cert", access.tls.certificate);
    add("key", access.tls.key);
    hosts->insert_or_assign(uri, std::move(host));
    std::ostringstream text;
    text << *hosts << '\n';

    const fs::path file = hosts_file();
    std::error_code error;
    if (fs::create_directories(file.parent_path(), error))
        fs::permissions(file.parent_path(), fs::perms::owner_all, error);
    std::string pattern = file.string() + ".XXXXXX";
    const int made = ::mkostemp(pattern.data(), O_CLOEXEC);  // mode 0600
    const std::string content = text.str();
    const bool written = made >= 0 && ::write(made, content.data(), content.size()) ==
                                          static_cast<ssize_t>(content.size());
    if (made >= 0) ::close(made);
    if (!written || ::rename(pattern.c_str(), file.c_str()) != 0) {
        const int why = errno;
        if (made >= 0) ::unlink(pattern.c_str());
        return fail(Exit::failed, "cannot write " + file.string() + ": " + std::strerror(why));
    }
    return {};
}

}  // namespace raynest::client
