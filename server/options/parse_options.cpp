#include "engine/packs/registry.h"
#include "server/ground/journal.h"
#include "server/options/config_file.h"
#include "server/options/limits_in_force.h"
#include "server/options/listen_policy.h"
#include "server/options/load_sources.h"
#include "server/options/option_words.h"
#include "server/options/options.h"
#include "server/options/socket_access.h"
#include "server/options/start_checks.h"
#include "server/options/toml_config.h"

#include <CLI/CLI.hpp>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <iostream>
#include <iterator>
#include <memory>
#include <system_error>
#include <thread>

namespace raynest::server {
namespace {

constexpr unsigned threads_max = 1024;
/// Maximum value of a limit: 140 years in milliseconds, which still fit a clock of nanoseconds.
constexpr std::uint64_t limit_max = 1ULL << 42;

std::uint64_t most_of(const protocol::LimitInfo& limit) {
    const protocol::Limits usual;
    return limit.value == &protocol::Limits::page_login_ms_max ? usual.page_login_ms_max
                                                               : limit_max;
}

std::uint64_t half_of_memory() {
    const auto pages = static_cast<std::uint64_t>(sysconf(_SC_PHYS_PAGES));
    return pages * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE)) / 2;
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

SocketAccess to_socket_access(const Words& words) {
    SocketAccess access;
    if (!words.socket_group.empty()) {
        access.group = to_group(words.socket_group);
        access.mode = 0660;
    }
    if (!words.socket_mode.empty()) access.mode = *to_mode(words.socket_mode);
    return access;
}

/// The lines of a configuration file that gave the values of options.
struct ConfigOrigins {
    struct Row {
        std::string option;
        std::string value;
        std::size_t line;
    };
    std::string file;
    std::vector<Row> rows;
};

/// Reads a configuration file (config_file.h). Errors name file, line and key.
class ConfigLines : public CLI::Config {
public:
    ConfigLines(const CLI::App& app, ConfigOrigins& origins) : app_(app), origins_(origins) {}
    std::vector<CLI::ConfigItem> from_config(std::istream& file) const override;
    // Returns nothing: print_config() is used instead, because it also writes the limits.
    std::string to_config(const CLI::App*, bool, bool, std::string) const override { return ""; }

private:
    const CLI::App& app_;
    ConfigOrigins& origins_;
};

void declare_security(CLI::App& app, SecurityOptions& security, Words& words) {
    app.add_option(
        "--tls-cert", security.tls.certificate,
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

void declare(CLI::App& app, Options& options, Words& words, ConfigOrigins& origins) {
    app.add_option("--listen", options.listen,
                   "tcp://HOST:PORT, tls://HOST:PORT or unix:PATH, repeatable; port 0 picks a free "
                   "one; fd:N "
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
    app.add_option(
           "--trusted-proxy", options.http.proxies,
           "Address, or network ADDRESS/BITS, of a proxy before the page: its X-Forwarded-For, "
           "-Proto and -Host count; repeatable")
        ->check(CLI::Validator(proxy_fault, ""));
    declare_security(app, options.security, words);
    app.add_option("--state", options.state,
                   "Folder in which scenes outlive the daemon; this daemon alone uses it");
    app.add_option("--scene-root", options.scene_root,
                   "Folder in which root:PATH is looked up; links must end inside")
        ->check(CLI::ExistingDirectory);
    app.add_option(
        "--load", options.load,
        "Scene to load at the start and to share with everybody, repeatable: a file, a pattern "
        "such as '/srv/scenes/*.glb', builtin:NAME or root:PATH");
    app.add_option("--pack-dir", options.pack_dirs, "Folder with more kernel packs, repeatable")
        ->check(CLI::ExistingDirectory);
    app.add_option("--threads", options.threads, "Compute threads, 1 to 1024")
        ->check(CLI::Range(1U, threads_max))
        ->capture_default_str();
    app.add_option("--memory", options.memory,
                   "Bytes for scenes, uploads and jobs, 1M to 1P, e.g. 8G or 1.5G")
        ->transform(CLI::Validator(memory_fault, ""))
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
    for (const protocol::LimitInfo& limit : protocol::limit_table())
        if (limit.policy) {
            auto* option = app.add_option("--" + hyphened(limit.name), options.limits.*limit.value,
                                          "Limit: " + std::string(limit.text));
            option->check(CLI::Range(std::uint64_t{1}, most_of(limit)))
                ->group("Limits")
                ->capture_default_str();
            if (limit.name.ends_with("bytes_max"))
                option->transform(CLI::Validator(bytes_fault, ""));
        }
    for (CLI::Option* option : app.get_options())
        if (option->get_configurable()) option->envname(variable_of(option->get_single_name()));
    app.set_config(
           "--config", "",
           "Read options from a file in TOML, as --print-config writes it; relative paths in it "
           "begin at its folder")
        ->check(CLI::Validator(
            [](const std::string& file) {
                const auto content = read_config_file(file);
                return content ? "" : "cannot read " + content.error().message;
            },
            ""))
        ->configurable(false);
    app.config_formatter(std::make_shared<ConfigLines>(app, origins));
    hide_checks(app);
}

/// Returns a message about an option spelled with underscores; empty if there is no such option.
std::string respelled(const CLI::App& app, const std::string& flag) {
    const std::string now = hyphened(flag);
    const bool old = now != flag && app.get_option_no_throw(now) != nullptr;
    return old ? flag + " is now spelled " + now : "";
}

/// Returns the error text of an option's values; empty if they are valid.
std::string config_fault(const CLI::ConfigItem& item) {
    Options options;
    Words words;
    CLI::App trial;
    ConfigOrigins origins;
    declare(trial, options, words, origins);
    if (!respelled(trial, "--" + item.name).empty())
        return "'" + item.name + "' is now spelled '" + hyphened(item.name) + "'";
    CLI::Option* option = trial.get_option_no_throw("--" + item.name);
    if (option == nullptr || !option->get_configurable())
        return "there is no option '" + item.name + "'; raynestd --print-config lists them";
    if (option->get_expected_max() == 1 && item.inputs.size() > 1)
        return "'" + item.name + "' takes one value and has more; keep one of them";
    try {
        for (const std::string& value : item.inputs) option->add_result(value);
        option->run_callback();
        return "";
    } catch (const CLI::Error& error) {
        const std::string fault = error.what();
        return fault.substr(fault.starts_with("--") ? 2 : 0);
    }
}

std::vector<CLI::ConfigItem> ConfigLines::from_config(std::istream& /*file*/) const {
    const std::string name = app_.get_config_ptr()->results().back();
    const auto refuse = [&](std::size_t line, const std::string& fault) {
        throw CLI::ConfigError(name + ", line " + std::to_string(line) + ": " + fault);
    };
    // The file is not read by its path: others could have led that elsewhere meanwhile.
    const auto content = read_config_file(name);
    if (!content) throw CLI::ConfigError("cannot read " + content.error().message);
    const auto keys = read_toml(*content);
    if (!keys) refuse(keys.error().line, keys.error().why);
    origins_ = {name, {}};
    std::vector<CLI::ConfigItem> read;
    for (const ConfigKey& key : *keys) {
        CLI::ConfigItem item{{}, key.name, {}};
        for (const std::string& value : key.values)
            item.inputs.push_back(resolve_path(key.name, value, name));
        if (const std::string fault = config_fault(item); !fault.empty()) refuse(key.line, fault);
        for (std::size_t i = 0; i < item.inputs.size(); ++i)
            origins_.rows.push_back({key.name, item.inputs[i], key.lines[i]});
        read.push_back(std::move(item));
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
        std::string listed;
        for (const std::string& value : values)
            listed.append(listed.empty() ? "" : ", ").append(toml_text(value));
        if (values.size() > 1) listed = "[" + listed + "]";
        if (values.empty())
            std::cout << "# " << name << " =\n";
        else
            std::cout << name << " = " << listed << '\n';
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

/// Where the options of a command line come from.
class Origins {
public:
    Origins(int argc, const char* const* argv, const ConfigOrigins& file)
        : arguments_(argv, argv + argc),
          file_(file) {}

    /// Returns the error text of an option, in the words of its place: "--listen ...",
    /// "RAYNEST_LISTEN ..." or "raynestd.toml, line 3: listen ...".
    [[nodiscard]] std::string text_of(const OptionFault& fault) const {
        const std::string flag = "--" + fault.option;
        if (is_given(flag)) return flag + ' ' + fault.why;
        if (is_in_environment(fault.option)) return variable_of(fault.option) + ' ' + fault.why;
        const ConfigOrigins::Row* found = nullptr;
        for (const ConfigOrigins::Row& row : file_.rows)
            if (row.option == fault.option && (fault.value.empty() || row.value == fault.value))
                found = &row;
        if (found == nullptr) return flag + ' ' + fault.why;
        return file_.file + ", line " + std::to_string(found->line) + ": " + fault.option + ' ' +
               without_dashes(fault.why);
    }
    /// Replaces an option in an error text by its environment variable if its value came from
    /// there.
    [[nodiscard]] std::string blamed(std::string what) const {
        if (!what.starts_with("--")) return what;
        const std::string option = what.substr(0, what.find_first_of(": ="));
        if (!is_given(option) && is_in_environment(option.substr(2)))
            what.replace(0, option.size(), variable_of(option.substr(2)));
        return what;
    }

private:
    [[nodiscard]] bool is_given(const std::string& flag) const {
        return std::ranges::any_of(arguments_, [&](const std::string& argument) {
            return argument == flag || argument.starts_with(flag + '=');
        });
    }
    /// Removes the dashes of option names in a text.
    static std::string without_dashes(std::string text) {
        for (std::size_t at = 0; (at = text.find(" --", at)) != std::string::npos; ++at)
            text.erase(at + 1, 2);
        return text;
    }

    const std::vector<std::string> arguments_;
    const ConfigOrigins& file_;
};

/// Ends a command that only prints; fails if stdout could not be written.
ParsedOptions printed() {
    if (std::cout.flush()) return {std::nullopt, 0, {}};
    std::cerr << "raynestd: cannot write stdout\n";
    return {std::nullopt, 1, {}};
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
        "certificates, raynestd token --help gives access. raynestd check DIR looks\n"
        "at a state folder, raynestd backup DIR NEW copies one, raynestd restore BACKUP DIR\n"
        "brings it back, and raynestd gc DIR removes what no scene needs; each takes --json.",
        "raynestd");
    app.footer(
        "\nExit codes: 0 stopped, 1 cannot start, 2 usage, 3 stopped before its jobs had ended.");
    bool print = false;
    bool check = false;
    ConfigOrigins file;
    const Origins origins(argc, argv, file);
    const auto refused = [&](int code, const std::string& fault) -> ParsedOptions {
        errors << journal_priority(LogLevel::error) << "raynestd: " << fault
               << (code == 2 ? "; see raynestd --help\n" : "\n");
        return {std::nullopt, code, fault};
    };
    try {
        declare(app, options, words, file);
        app.add_flag("--print-config", print, "Print all options and limits, then exit")
            ->configurable(false);
        app.add_flag("--check-config", check,
                     "Check the configuration and the files that a start needs, then exit")
            ->configurable(false);
        app.add_flag("--takeover", options.takeover,
                     "Take the place of the daemon that uses the folder of --state: its scenes and "
                     "sockets; nobody is refused meanwhile")
            ->configurable(false);
        app.set_version_flag("--version", "raynestd " RAYNEST_VERSION);
        // Neither the help nor a printed configuration names a number: it follows other options.
        for (const std::string& limit : derived_limits()) app.get_option(limit)->default_str("");
        refuse_old_spelling(app, argc, argv);
        app.parse(argc, argv);
        options.security.anonymous = parse_role(words.anonymous);
        if (const auto fault = listen_fault(options)) return refused(2, origins.text_of(*fault));
        if (options.takeover && options.state.empty())
            return refused(2, "--takeover needs the --state DIR of the daemon that is to give way");
        forget_defaults(options.limits,
                        [&](const std::string& limit) { return app.count(limit) == 0; });
        options.http.given = app.count("--http") != 0;
        options.socket = to_socket_access(words);
        options.log_level = to_log_level(words.log_level);
        options.log_format = words.log_format == "json" ? LogFormat::json : LogFormat::text;
        options.cuda_pack = to_cuda_pack(words.cuda);
        if (check) {
            const std::string user = become_service_user(file.file);
            if (const auto fault = start_fault(options))
                return refused(1, origins.text_of(*fault) +
                                      (user.empty() ? "" : " (checked as the user " + user + ")"));
            const auto addresses = listen_addresses(options);
            for (const ListenAddress& at : *addresses)
                std::cout << at.value << " would be open to "
                          << to_text(openness(at, options.security, options.socket)) << '\n';
            std::cout << "the configuration is valid"
                      << (user.empty() ? "" : " for the user " + user) << '\n';
            for (const StartWarning& warning : start_warnings(options))
                std::cout << "warning: " << warning.reason << '\n';
            for (const std::string& source : options.load)
                if (files_of(source).empty())
                    std::cout << "warning: --load finds no file " << source << '\n';
            return printed();
        }
        if (!print) return {options, 0, {}};
        print_config(app);
        return printed();
    } catch (const CLI::Success& answered) {
        app.exit(answered);
        return printed();
    } catch (const CLI::FileError&) {
        const auto name = app.get_config_ptr()->as<std::string>();
        return refused(2, "--config: cannot read " + name + ": " + std::strerror(errno));
    } catch (const CLI::Error& error) {
        return refused(2, origins.blamed(error.what()));
    }
}

}  // namespace raynest::server
