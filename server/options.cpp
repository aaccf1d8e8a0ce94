#include "server/options.h"

#include "engine/packs/registry.h"
#include "server/address.h"
#include "server/net/http_site.h"
#include "server/socket_access.h"
#include "server/toml_config.h"

#include <CLI/CLI.hpp>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <iomanip>
#include <iostream>
#include <iterator>
#include <memory>
#include <optional>
#include <set>
#include <sstream>
#include <string_view>
#include <thread>

namespace raynest::server {
namespace {

constexpr unsigned threads_max = 1024;
/// Maximum value of a limit: 140 years in milliseconds, which still fit a clock of nanoseconds.
constexpr std::uint64_t limit_max = 1ULL << 42;

std::uint64_t half_of_memory() {
    const auto pages = static_cast<std::uint64_t>(sysconf(_SC_PHYS_PAGES));
    return pages * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE)) / 2;
}

// Returns the error text for CLI11; empty if there is no error.
std::string address_fault(const std::string& uri) {
    const auto address = parse_address(uri);
    return address ? std::string() : address.error().message;
}

std::string http_fault(const std::string& text) {
    if (text == "off") return {};
    const auto address = parse_http_address(text);
    return address ? std::string() : address.error().message;
}

std::string http_host_fault(const std::string& text) {
    return is_http_host(text) ? "" : "'" + text + "' is not a host; write NAME or NAME:PORT";
}

/// Values of options as text, before they are converted.
struct Words {
    std::string log_level = "info";
    std::string log_format = "text";
    std::string cuda = "auto";
    std::string socket_mode;
    std::string socket_group;
    std::string anonymous = "user";
};

/// Returns the spelling of an option: principal_jobs_max -> principal-jobs-max.
std::string hyphened(std::string_view name) {
    std::string text(name);
    std::replace(text.begin(), text.end(), '_', '-');
    return text;
}

/// Returns the environment variable of an option: log-level -> RAYNEST_LOG_LEVEL. --cuda has none:
/// the build has a variable of that name.
std::string variable_of(const std::string& option) {
    if (option == "cuda") return "";
    std::string name = "RAYNEST_";
    for (const char c : option) name += c == '-' ? '_' : static_cast<char>(std::toupper(c));
    return name;
}

SocketAccess to_socket_access(const Words& words) {
    SocketAccess access;
    if (!words.socket_group.empty()) {
        access.group = to_group(words.socket_group);
        access.mode = 0660;
    }
    if (!words.socket_mode.empty()) access.mode = *to_mode(words.socket_mode);
    return access;
}

/// Parses a size such as 8G, 1.5GiB or 500m; nothing if it is invalid or not from 1M to 1P.
std::optional<std::uint64_t> to_size(const std::string& text) {
    double number = 0;
    const char* last = text.data() + text.size();
    const auto [end, error] = std::from_chars(text.data(), last, number);
    std::string unit = CLI::detail::to_lower(CLI::detail::trim_copy(std::string(end, last)));
    for (const char* end_of_unit : {"b", "i"})
        if (unit.ends_with(end_of_unit)) unit.pop_back();
    const std::size_t power = unit.size() == 1 ? std::string_view(" kmgtp").find(unit) : 0;
    if (error != std::errc{} || unit.size() > 1 || power == std::string_view::npos)
        return std::nullopt;
    number = std::ldexp(number, static_cast<int>(10 * power));
    const bool fits = number >= std::ldexp(1, 20) && number <= std::ldexp(1, 50);
    return fits ? std::optional(static_cast<std::uint64_t>(number)) : std::nullopt;
}

// Replaces the text by the number of bytes, as CLI11's transform() expects. Returns the error text.
std::string size_fault(std::string& text) {
    const auto bytes = to_size(text);
    if (!bytes) return "'" + text + "' is not a size from 1M to 1P, such as 8G or 1.5G";
    text = std::to_string(*bytes);
    return "";
}

LogLevel to_log_level(const std::string& word) {
    if (word == "error") return LogLevel::error;
    if (word == "warn") return LogLevel::warn;
    return word == "debug" ? LogLevel::debug : LogLevel::info;
}

std::filesystem::path to_cuda_pack(const std::string& word) {
    if (word == "off") return {};
    if (word != "auto") return std::filesystem::absolute(word);
    std::error_code error;
    const auto pack =
        builtin_pack_directory().parent_path() / "raynest-cuda" / "raynest-pack-cuda.so";
    return std::filesystem::exists(pack, error) ? pack : std::filesystem::path();
}

/// Reads a configuration file: KEY=VALUE lines, empty lines and comments. A value with blanks, '#'
/// or quotes must be quoted; --print-config quotes all values. Errors name file, line and key.
class ConfigLines : public CLI::Config {
public:
    explicit ConfigLines(const CLI::App& app) : app_(app) {}
    std::vector<CLI::ConfigItem> from_config(std::istream& file) const override;
    // Returns nothing: print_config() is used instead, because it also writes the limits.
    std::string to_config(const CLI::App*, bool, bool, std::string) const override { return ""; }

private:
    const CLI::App& app_;
};

void declare_security(CLI::App& app, SecurityOptions& security, Words& words) {
    app.add_option("--tls-cert", security.tls.certificate,
                   "PEM file of the certificate of tls:// and https://, and its chain; SIGHUP reads "
                   "it again");
    app.add_option("--tls-key", security.tls.key, "PEM file of its key, mode 0600");
    app.add_option("--client-ca", security.tls.client_ca,
                   "PEM file of the CAs of client certificates; a certificate's subject is the "
                   "principal");
    app.add_option("--tokens", security.tokens,
                   "Token file, written by raynestd token add; tls:// and https:// then ask for a "
                   "token or a certificate; watched");
    app.add_option("--anonymous", words.anonymous,
                   "Role of clients without a token on loopback and Unix sockets: off, viewer or "
                   "user")
        ->check(CLI::IsMember({"off", "viewer", "user"}))
        ->capture_default_str();
    app.add_flag("--insecure", security.insecure,
                 "Allow tcp:// and --http beyond loopback without encryption");
}

/// Leaves the names of the checks out of the help, such as "UINT in [1 - 1024]": the texts say in
/// words what is allowed.
void hide_checks(CLI::App& app) {
    for (CLI::Option* option : app.get_options()) {
        try {
            for (int i = 0;; ++i) option->get_validator(i)->description("");
        } catch (const CLI::OptionNotFound&) {  // behind the last one
        }
    }
}

void declare(CLI::App& app, Options& options, Words& words) {
    app.add_option(
           "--listen", options.listen,
           "tcp://HOST:PORT, tls://HOST:PORT or unix:PATH, repeatable; port 0 picks a free one; fd:N "
           "or tls://fd:N is a listening socket that the daemon inherits")
        ->check(CLI::Validator(address_fault, ""))
        ->default_str(options.listen.front());
    app.add_option("--socket-mode", words.socket_mode,
                   "Mode of a unix:PATH socket, octal; 0600, with --socket-group 0660")
        ->check(CLI::Validator(mode_fault, ""));
    app.add_option("--socket-group", words.socket_group,
                   "Group that a unix:PATH socket is opened to, by name or number")
        ->check(CLI::Validator(group_fault, ""));
    app.add_option("--http", options.http.address,
                   "HOST:PORT of the page, its WebSocket, /healthz and /metrics, or "
                   "https://HOST:PORT, or off; port 0 picks a free one")
        ->check(CLI::Validator(http_fault, ""))
        ->capture_default_str();
    app.add_option("--http-host", options.http.hosts,
                   "Host name besides loopback under which the page may be opened, NAME or "
                   "NAME:PORT, repeatable")
        ->check(CLI::Validator(http_host_fault, ""));
    declare_security(app, options.security, words);
    app.add_option("--state", options.state, "Folder that this daemon alone may use; locked");
    app.add_option("--scene-root", options.scene_root,
                   "Folder in which root:PATH is looked up; links must end inside")
        ->check(CLI::ExistingDirectory);
    app.add_option("--pack-dir", options.pack_dirs, "Folder with more kernel packs, repeatable")
        ->check(CLI::ExistingDirectory);
    app.add_option("--threads", options.threads, "Compute threads, 1 to 1024")
        ->check(CLI::Range(1U, threads_max))
        ->capture_default_str();
    app.add_option("--memory", options.memory,
                   "Bytes for scenes, uploads and jobs, 1M to 1P, e.g. 8G or 1.5G")
        ->transform(CLI::Validator(size_fault, ""))
        ->capture_default_str();
    std::vector<std::string> targets = {"auto"};
    targets.insert(targets.end(), cpu_targets().begin(), cpu_targets().end());
    app.add_option("--target", options.target, "Kernel pack: " + CLI::detail::join(targets, ", "))
        ->check(CLI::IsMember(targets))
        ->capture_default_str();
    app.add_option("--cuda", words.cuda,
                   "CUDA worker: auto (where its kernel pack was built), off, or the pack's file")
        ->check(CLI::IsMember({"auto", "off"}) | CLI::ExistingFile)
        ->capture_default_str();
    app.add_option("--ready-file", options.ready_file,
                   "Written once requests are served: {\"listen\":[...],\"http\":...,\"pid\":...}; "
                   "replaces an empty file or an older ready file, nothing else");
    app.add_option("--log-level", words.log_level, "error, warn, info or debug")
        ->check(CLI::IsMember({"error", "warn", "info", "debug"}))
        ->capture_default_str();
    app.add_option("--log-format", words.log_format, "text, or json for an object per line")
        ->check(CLI::IsMember({"text", "json"}))
        ->capture_default_str();
    for (CLI::Option* option : app.get_options())
        if (option->get_configurable()) option->envname(variable_of(option->get_single_name()));
    for (const protocol::LimitInfo& limit : protocol::limit_table())
        if (limit.policy)
            app.add_option("--" + hyphened(limit.name), options.limits.*limit.value,
                           "Limit: " + std::string(limit.text))
                ->check(CLI::Range(std::uint64_t{1}, limit_max))
                ->group("Limits")
                ->capture_default_str();
    app.set_config("--config", "",
                   "Read options from a file: .toml, or else as --print-config writes it")
        ->configurable(false);
    app.config_formatter(std::make_shared<ConfigLines>(app));
    hide_checks(app);
}

/// Returns a message about an option spelled with underscores; empty if there is no such option.
std::string respelled(const CLI::App& app, const std::string& flag) {
    const std::string now = hyphened(flag);
    const bool old = now != flag && app.get_option_no_throw(now) != nullptr;
    return old ? flag + " is now spelled " + now : "";
}

/// Splits the part of a line after KEY= into values: words or quoted texts. '#' before a value
/// begins a comment. Returns nothing if a quote is not closed.
std::optional<std::vector<std::string>> to_values(const std::string& text) {
    std::vector<std::string> values;
    std::istringstream left(text);
    while (!(left >> std::ws).eof() && left.peek() != '#') {
        const auto first = static_cast<char>(left.peek());
        std::string& value = values.emplace_back();
        if (first == '"' || first == '\'')
            left >> std::quoted(value, first);
        else
            left >> value;
        if (!left) return std::nullopt;
    }
    return values;
}

/// Parses a line of a configuration file, without its newline, into an option and its values.
/// Returns nothing for an empty line or a comment, and the error text for an invalid line.
tl::expected<std::optional<CLI::ConfigItem>, std::string> to_item(const std::string& line) {
    const auto is_control = [](char c) { return c != '\t' && (c == 0x7F || (c >= 0 && c < ' ')); };
    const std::string text = CLI::detail::trim_copy(line);
    if (text.empty() || text.front() == '#') return std::nullopt;
    if (std::ranges::any_of(text, is_control))
        return tl::unexpected<std::string>("it holds a control character; write plain text");
    if (text.front() == '[')
        return tl::unexpected<std::string>(
            "sections are not known here; write KEY=VALUE, as raynestd --print-config does");
    const std::size_t equals = text.find('=');
    CLI::ConfigItem item;
    item.name = CLI::detail::trim_copy(text.substr(0, equals));
    const auto values = to_values(equals == std::string::npos ? "" : text.substr(equals + 1));
    if (!values) return tl::unexpected("'" + item.name + "' has a quote that is not closed");
    if (values->empty() || std::ranges::count(*values, "") != 0)
        return tl::unexpected("'" + item.name + "' has no value; write " + item.name +
                              "=VALUE, or leave the line out");
    item.inputs = *values;
    return item;
}

/// Returns the error text of an option's values; empty if they are valid. `before` are the values
/// of the same option on earlier lines.
std::string config_fault(const CLI::ConfigItem& item, const std::vector<std::string>& before) {
    Options options;
    Words words;
    CLI::App trial;
    declare(trial, options, words);
    if (!respelled(trial, "--" + item.name).empty())
        return "'" + item.name + "' is now spelled '" + hyphened(item.name) + "'";
    CLI::Option* option = trial.get_option_no_throw("--" + item.name);
    if (option == nullptr || !option->get_configurable())
        return "there is no option '" + item.name + "'; raynestd --print-config lists them";
    if (option->get_expected_max() == 1 && before.size() + item.inputs.size() > 1)
        return "'" + item.name + "' takes one value and " +
               (before.empty() ? "has more" : "has one above") + "; keep one of them";
    try {
        for (const std::string& value : item.inputs) option->add_result(value);
        option->run_callback();
        return "";
    } catch (const CLI::Error& error) {
        const std::string fault = error.what();
        return fault.substr(fault.starts_with("--") ? 2 : 0);
    }
}

/// True if the environment sets the option: it wins over the configuration file.
bool is_in_environment(const std::string& option) {
    // getenv() is safe here: no other thread has started yet.
    return std::getenv(variable_of(option).c_str()) != nullptr;  // NOLINT(concurrency-mt-unsafe)
}

std::vector<CLI::ConfigItem> from_toml(const std::string& name, std::istream& file) {
    std::ostringstream text;
    text << file.rdbuf();
    const std::string content = std::move(text).str();
    const auto refuse = [&](std::size_t line, const std::string& fault) {
        throw CLI::ConfigError(name + ", line " + std::to_string(line) + ": " + fault);
    };
    std::vector<CLI::ConfigItem> items;
    const auto keys = read_toml(content);
    if (!keys) refuse(keys.error().line, keys.error().why);
    for (const ConfigKey& key : *keys) {
        const CLI::ConfigItem item{{}, key.name, key.values};
        if (const std::string fault = config_fault(item, {}); !fault.empty())
            refuse(key.line, fault);
        if (!is_in_environment(key.name)) items.push_back(item);
    }
    return items;
}

std::vector<CLI::ConfigItem> ConfigLines::from_config(std::istream& file) const {
    if (const std::string name = app_.get_config_ptr()->results().back(); name.ends_with(".toml"))
        return from_toml(name, file);
    constexpr std::string_view byte_order_mark = "\xEF\xBB\xBF";
    std::vector<CLI::ConfigItem> read;
    std::string line;
    for (std::size_t number = 1; std::getline(file, line); ++number) {
        if (number == 1 && line.starts_with(byte_order_mark)) line.erase(0, byte_order_mark.size());
        const auto refuse = [&](const std::string& fault) {
            throw CLI::ConfigError(app_.get_config_ptr()->results().back() + ", line " +
                                   std::to_string(number) + ": " + fault);
        };
        auto item = to_item(line);
        if (!item) refuse(item.error());
        if (!*item) continue;
        auto same = std::ranges::find(read, (*item)->name, &CLI::ConfigItem::name);
        if (same == read.end()) same = read.insert(same, CLI::ConfigItem{{}, (*item)->name, {}});
        if (const std::string fault = config_fault(**item, same->inputs); !fault.empty())
            refuse(fault);
        // Merge items of the same name: CLI11 would use only the first.
        same->inputs.insert(same->inputs.end(), (*item)->inputs.begin(), (*item)->inputs.end());
    }
    std::erase_if(read, [](const auto& item) { return is_in_environment(item.name); });
    return read;
}

// Writes each option below its description; an option without a value becomes a comment.
void print_config(const CLI::App& app) {
    std::cout << "# raynestd --config FILE reads this file; flags win over it.\n";
    for (const CLI::Option* option : app.get_options()) {
        if (!option->get_configurable()) continue;
        std::vector<std::string> values = option->results();
        if (values.empty() && !option->get_default_str().empty())
            values.push_back(option->get_default_str());
        std::cout << "\n# " << option->get_description() << '\n';
        const std::string name = option->get_single_name();
        if (values.empty()) std::cout << "# " << name << "=\n";
        for (const std::string& value : values)
            std::cout << name << '=' << std::quoted(value) << '\n';
    }
    std::cout << "\n# Limits of the protocol, not configurable:\n";
    const protocol::Limits limits;
    for (const protocol::LimitInfo& limit : protocol::limit_table())
        if (!limit.policy)
            std::cout << "#   " << limit.name << " = " << limits.*limit.value << "  # "
                      << limit.text << '\n';
}

void refuse_old_spelling(const CLI::App& app, int argc, const char* const* argv) {
    for (int i = 1; i < argc; ++i) {
        const std::string argument = argv[i];
        if (!argument.starts_with("--")) continue;
        const std::string complaint = respelled(app, argument.substr(0, argument.find('=')));
        if (!complaint.empty()) throw CLI::ParseError(complaint, CLI::ExitCodes::ExtrasError);
    }
}

/// Refuses two listeners on one address; port 0 is a different port each time.
void refuse_repeated(const std::vector<std::string>& listen) {
    std::set<std::string> seen;
    for (const std::string& uri : listen)
        if (const std::string place = to_uri(*parse_address(uri));
            !place.ends_with(":0") && !seen.insert(place).second)
            throw CLI::ValidationError("--listen", "'" + uri + "' is given twice");
}

/// Replaces an option in an error text by its environment variable if its value came from there.
std::string blamed(std::string what, int argc, const char* const* argv) {
    if (!what.starts_with("--")) return what;
    const std::string option = what.substr(0, what.find_first_of(": ="));
    const bool given = std::any_of(argv, argv + argc, [&](const char* argument) {
        return std::string_view(argument).starts_with(option);
    });
    if (!given && is_in_environment(option.substr(2)))
        what.replace(0, option.size(), variable_of(option.substr(2)));
    return what;
}

/// Ends a command that only prints; fails if stdout could not be written.
ParsedOptions printed() {
    if (std::cout.flush()) return {std::nullopt, 0};
    std::cerr << "raynestd: cannot write stdout\n";
    return {std::nullopt, 1};
}

}  // namespace

ParsedOptions parse_options(int argc, const char* const* argv, std::ostream& errors) {
    Options options;
    options.threads = std::clamp(std::thread::hardware_concurrency(), 1U, threads_max);
    options.memory = half_of_memory();
    Words words;

    CLI::App app(
        "Example:\n"
        "  raynestd --listen tcp://127.0.0.1:0 --ready-file /tmp/raynest.json\n\n"
        "raynestd traces rays through instanced scenes for clients. raynestd tls --help makes\n"
        "certificates, raynestd token --help gives access.",
        "raynestd");
    app.footer(
        "\nExit codes: 0 stopped, 1 cannot start, 2 usage, 3 stopped before its jobs had ended.");
    bool print = false;
    bool check = false;
    try {
        declare(app, options, words);
        app.add_flag("--print-config", print, "Print all options and limits, then exit")
            ->configurable(false);
        app.add_flag("--check-config", check, "Check the configuration, then exit")
            ->configurable(false);
        app.set_version_flag("--version", "raynestd " RAYNEST_VERSION);
        refuse_old_spelling(app, argc, argv);
        app.parse(argc, argv);
        refuse_repeated(options.listen);
        options.security.anonymous = parse_role(words.anonymous);
        if (const std::string fault = listen_fault(options); !fault.empty())
            throw CLI::ValidationError(fault);
        options.http.given = app.count("--http") != 0;
        options.socket = to_socket_access(words);
        options.log_level = to_log_level(words.log_level);
        options.log_format = words.log_format == "json" ? LogFormat::json : LogFormat::text;
        options.cuda_pack = to_cuda_pack(words.cuda);
        if (check) std::cout << "the configuration is valid\n";
        if (check) return printed();
        if (!print) return {options, 0};
        print_config(app);
        return printed();
    } catch (const CLI::Success& answered) {
        app.exit(answered);
        return printed();
    } catch (const CLI::FileError&) {
        const auto file = app.get_config_ptr()->as<std::string>();
        std::error_code ignored;
        const bool is_folder = std::filesystem::is_directory(file, ignored);
        errors << "raynestd: --config: cannot read " << file << ": "
                  << (is_folder ? "it is a folder" : std::strerror(errno))
                  << "; see raynestd --help\n";
        return {std::nullopt, 2};
    } catch (const CLI::Error& error) {
        errors << "raynestd: " << blamed(error.what(), argc, argv) << "; see raynestd --help\n";
        return {std::nullopt, 2};
    }
}

}  // namespace raynest::server
