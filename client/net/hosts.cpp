#include "client/net/hosts.h"

#include "client/ground/descriptor.h"
#include "client/ground/text.h"
#include "client/net/address.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <sstream>
#include <utility>

#define TOML_HEADER_ONLY 1
#define TOML_EXCEPTIONS 0
#include <toml++/toml.h>

namespace raynest::client {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t file_bytes_max = 1 << 20;

struct Item {
    const char* key;
    std::string KeptHost::*value;
};
/// The items of an entry that are files.
constexpr std::array files = {Item{"ca", &KeptHost::ca}, Item{"cert", &KeptHost::certificate},
                              Item{"key", &KeptHost::key}};

tl::unexpected<Failure> cannot(const char* act, const std::string& file, int why) {
    return fail(Exit::usage, std::string("cannot ") + act + " " + file + ": " + std::strerror(why));
}

Result<std::string> read_regular(const std::string& file, std::size_t bytes_max, bool is_secret) {
    struct stat status {};
    const Descriptor opened(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
    if (!opened || ::fstat(opened.number(), &status) != 0) return cannot("read", file, errno);
    if (is_secret && (!S_ISREG(status.st_mode) || (status.st_mode & 077U) != 0))
        return fail(Exit::usage,
                    "other users may read " + file + ", and it holds a token; chmod 600 " + file);
    if (!S_ISREG(status.st_mode))
        return fail(Exit::usage, file + " is no regular file, of which a copy could be kept");
    std::string content;
    std::array<char, 4096> part{};
    while (content.size() <= bytes_max) {
        const ssize_t got = ::read(opened.number(), part.data(), part.size());
        if (got < 0) return cannot("read", file, errno);
        if (got == 0) return content;
        content.append(part.data(), static_cast<std::size_t>(got));
    }
    return fail(Exit::usage, file + " is over " + std::to_string(bytes_max) + " bytes");
}

/// Holds the folder of hosts.toml while it lives: who reads that file and writes it again would lose
/// what another process wrote meanwhile.
Descriptor hold_folder() {
    const fs::path path = fs::path(hosts_file()).parent_path();
    Descriptor folder(::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (folder) (void)::flock(folder.number(), LOCK_EX);
    return folder;
}

/// Writes a file of mode 0600 in one step: it is there whole or not at all. A link stays one.
Result<void> write_private(const fs::path& link, const std::string& content) {
    std::error_code error;
    const fs::path end = fs::canonical(link, error);
    const fs::path& file = error ? link : end;
    std::string pattern = file.string() + ".XXXXXX";
    const Descriptor made(::mkostemp(pattern.data(), O_CLOEXEC));  // mode 0600
    if (!made) return cannot("write", file.string(), errno);
    // On the disk first: a crash after the rename must not leave an empty file.
    const bool written = ::write(made.number(), content.data(), content.size()) ==
                             static_cast<ssize_t>(content.size()) &&
                         ::fsync(made.number()) == 0;
    if (written && ::rename(pattern.c_str(), file.c_str()) == 0) return {};
    const int why = errno;
    ::unlink(pattern.c_str());
    return cannot("write", file.string(), why);
}

/// A line, and the daemon whose entry it belongs to; empty: none's.
struct Line {
    std::string text, uri;
};

struct HostsText {
    std::vector<Line> lines;
    toml::table entries;  ///< by comparable addresses
    std::vector<std::string> warnings;
};

/// Reads line by line. A broken heading hides the lines below it.
HostsText parse(const std::string& content) {
    HostsText hosts;
    std::istringstream stream(content);
    std::string uri;
    bool is_hidden = false;
    for (std::string text; std::getline(stream, text);) {
        if (!text.empty() && text.back() == '\r') text.pop_back();
        const std::size_t first = text.find_first_not_of(" \t");
        const bool is_heading = first != std::string::npos && text[first] == '[';
        auto parsed = toml::parse(text);
        if (is_heading) {
            is_hidden =
                !parsed || parsed.table().size() != 1 || !parsed.table().begin()->second.is_table();
            uri = is_hidden ? "" : comparable(std::string(parsed.table().begin()->first.str()));
        }
        if (!parsed || (is_heading && is_hidden))
            hosts.warnings.push_back(hosts_file() + ": line " +
                                     std::to_string(hosts.lines.size() + 1) +
                                     " cannot be read and is left out; correct or remove it");
        hosts.lines.push_back({text, uri});
        if (!parsed || is_hidden || is_heading) continue;
        for (auto& [key, value] : parsed.table()) {
            if (uri.empty() && !value.is_table()) continue;
            const std::string name = uri.empty() ? comparable(std::string(key.str())) : uri;
            toml::table& entry =
                *hosts.entries.insert(name, toml::table()).first->second.as_table();
            if (!uri.empty()) {
                entry.insert_or_assign(key, value);
            } else {  // URI = { token = "..." }
                hosts.lines.back().uri = name;
                entry = *value.as_table();
            }
        }
    }
    return hosts;
}

Result<HostsText> read_hosts() {
    struct stat status {};
    // As ssh does, where HOME is still that of another user.
    if (::stat(hosts_file().c_str(), &status) != 0) return HostsText();
    auto content = read_secret(hosts_file(), file_bytes_max);
    if (!content) return tl::unexpected<Failure>(content.error());
    return parse(*content);
}

/// Drops a daemon's lines, but not the comments among them; true if there were some.
bool drop(HostsText& hosts, const std::string& uri) {
    return std::erase_if(hosts.lines, [&](const Line& line) {
               return line.uri == uri && !line.text.starts_with('#');
           }) != 0;
}

std::string text_of(const HostsText& hosts) {
    std::string text;
    for (const Line& line : hosts.lines) text += line.text + '\n';
    return text;
}

/// The name of a kept copy, beside hosts.toml.
std::string copy_name(const std::string& uri, const char* key) {
    return uri.substr(uri.find("://") + 3) + "." + key + ".pem";
}

/// True for a name that copy_name() makes: a path from elsewhere is not this program's to remove.
bool is_copy(const std::string& name) {
    return !name.empty() && name.find('/') == std::string::npos && name.ends_with(".pem");
}

fs::path beside(const std::string& name) {
    return fs::path(hosts_file()).parent_path() / name;
}

/// Returns the item's text; "" where there is none.
std::string item(const HostsText& hosts, const std::string& uri, const char* key) {
    return hosts.entries[uri][key].value_or(std::string());
}

}  // namespace

std::string hosts_file() {
    const std::string config = environment_variable("XDG_CONFIG_HOME");
    if (config.starts_with('/')) return config + "/raynest/hosts.toml";
    return environment_variable("HOME") + "/.config/raynest/hosts.toml";
}

Result<std::string> read_secret(const std::string& file, std::size_t bytes_max) {
    return read_regular(file, bytes_max, true);
}

Result<KeptHost> find_host(const std::string& uri) {
    auto hosts = read_hosts();
    if (!hosts) return tl::unexpected<Failure>(hosts.error());
    const std::string name = comparable(uri);
    KeptHost host;
    host.token = item(*hosts, name, "token");
    for (const auto& [key, value] : files)
        if (const std::string file = item(*hosts, name, key); !file.empty())
            host.*value = beside(file).string();
    host.warnings = std::move(hosts->warnings);
    return host;
}

Result<void> keep_host(const std::string& uri, const KeptHost& host) {
    std::error_code ignored;
    const fs::path folder = fs::path(hosts_file()).parent_path();
    if (fs::create_directories(folder, ignored))
        fs::permissions(folder, fs::perms::owner_all, ignored);
    const Descriptor held = hold_folder();
    auto hosts = read_hosts();
    if (!hosts) return tl::unexpected<Failure>(hosts.error());
    const std::string name = comparable(uri);
    toml::table entry;
    if (!host.token.empty()) entry.insert("token", host.token);
    for (const auto& [key, value] : files) {
        if ((host.*value).empty() || !name.starts_with("tls://")) continue;
        const auto content = read_regular(host.*value, file_bytes_max, false);
        if (!content) return tl::unexpected<Failure>(content.error());
        const std::string copy = copy_name(name, key);
        if (auto written = write_private(beside(copy), *content); !written) return written;
        entry.insert(key, copy);
    }
    drop(*hosts, name);
    std::ostringstream text;
    text << text_of(*hosts) << toml::table{{{name, entry}}} << '\n';
    if (auto written = write_private(hosts_file(), text.str()); !written) return written;
    for (const auto& [key, value] : files)
        if (const std::string old = item(*hosts, name, key); is_copy(old) && !entry.contains(key))
            fs::remove(beside(old), ignored);
    return {};
}

Result<bool> forget_host(const std::string& uri) {
    const Descriptor held = hold_folder();
    auto hosts = read_hosts();
    if (!hosts) return tl::unexpected<Failure>(hosts.error());
    const std::string name = comparable(uri);
    if (!drop(*hosts, name)) return false;
    if (auto written = write_private(hosts_file(), text_of(*hosts)); !written)
        return tl::unexpected<Failure>(written.error());
    std::error_code ignored;
    for (const auto& [key, value] : files)
        if (const std::string old = item(*hosts, name, key); is_copy(old))
            fs::remove(beside(old), ignored);
    return true;
}

}  // namespace raynest::client
