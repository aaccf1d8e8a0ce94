#include "server/options.h"

#include "engine/packs/registry.h"
#include "server/address.h"

#include <CLI/CLI.hpp>
#include <grp.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <iostream>
#include <memory>
#include <optional>
#include <sstream>
#include <string_view>
#include <thread>

namespace raynest::server {
namespace {

constexpr unsigned threads_max = 1024;
/// As milliseconds 140 years, which a clock that counts nanoseconds can still add to.
constexpr std::uint64_t limit_max = 1ULL << 42;

std::uint64_t half_of_memory() {
    const auto pages = static_cast<std::uint64_t>(sysconf(_SC_PHYS_PAGES));
    return pages * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE)) / 2;
}

// CLI11 wants the text of a fault, empty when there is none.
std::string address_fault(const std::string& uri) {
    const auto address = parse_address(uri);
    return address ? std::string() : address.error().message;
}

/// Options that are words for something else.
struct Words {
    std::string http = "off";
    std::string log_level = "info";
    std::string cuda = "auto";
    std::string socket_mode;
    std::string socket_group;
};

/// principal_jobs_max -> principal-jobs-max: how options are spelled.
std::string hyphened(std::string_view name) {
    std::string text(name);
    std::replace(text.begin(), text.end(), '_', '-');
    return text;
}

/// Octal; none where it is no mode that the owner could use.
std::optional<unsigned> to_mode(const std::string& text) {
    unsigned mode = 0;
    const char* last = text.data() + text.size();
    const auto [end, error] = std::from_chars(text.data(), last, mode, 8);
    if (error != std::errc{} || end != last || mode > 0777 || (mode & 0600U) != 0600)
        return std::nullopt;
    return mode;
}

std::string mode_fault(const std::string& text) {
    return to_mode(text) ? "" : "'" + text + "' is not a mode of 0600 to 0777, such as 0660";
}

/// The number of a group by its name or number.
std::optional<unsigned> to_group(const std::string& text) {
    unsigned number = 0;
    const char* last = text.data() + text.size();
    const auto [end, error] = std::from_chars(text.data(), last, number);
    if (error == std::errc{} && end == last) return number;
    // Before any thread starts.
    const group* known = getgrnam(text.c_str());  // NOLINT(concurrency-mt-unsafe)
    return known == nullptr ? std::nullopt : std::optional<unsigned>(known->gr_gid);
}

std::string group_fault(const std::string& text) {
    return to_group(text) ? "" : "there is no group '" + text + "'";
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

/// Reads the configuration file line by line, so that a fault names its file, its line and its key.
class ConfigLines : public CLI::ConfigBase {
public:
    explicit ConfigLines(const CLI::App& app) : app_(app) {}
    std::vector<CLI::ConfigItem> from_config(std::istream& file) const override;

private:
    const CLI::App& app_;
};

void declare(CLI::App& app, Options& options, Words& words) {
    app.add_option(
           "--listen", options.listen,
           "tcp://HOST:PORT or unix:PATH, repeatable; loopback only; port 0 picks a free one")
        ->check(CLI::Validator(address_fault, ""))
        ->default_str(options.listen.front());
    app.add_option("--socket-mode", words.socket_mode,
                   "Mode of a unix:PATH socket, octal; 0600, with --socket-group 0660")
        ->check(CLI::Validator(mode_fault, ""));
    app.add_option("--socket-group", words.socket_group,
                   "Group that a unix:PATH socket is opened to, by name or number")
        ->check(CLI::Validator(group_fault, ""));
    app.add_option("--http", words.http, "Diagnostics port; this version has none: only 'off'")
        ->check(CLI::IsMember({"off"}))
        ->capture_default_str();
    app.add_option("--state", options.state, "Folder that this daemon alone may use; locked");
    app.add_option("--scene-root", options.scene_root,
                   "Folder in which root:PATH is looked up; links must end inside")
        ->check(CLI::ExistingDirectory);
    app.add_option("--pack-dir", options.pack_dirs, "Folder with more kernel packs, repeatable")
        ->check(CLI::ExistingDirectory);
    app.add_option("--threads", options.threads, "Compute threads")
        ->check(CLI::Range(1U, threads_max))
        ->capture_default_str();
    app.add_option("--memory", options.memory, "Bytes for scenes, uploads and jobs, e.g. 8G")
        ->transform(CLI::AsSizeValue(false))
        ->check(CLI::Range(std::uint64_t{1} << 20, std::uint64_t{1} << 50))
        ->capture_default_str();
    app.add_option("--target", options.target, "Kernel pack: auto, v2, v3 or v4")
        ->envname("RAYNEST_TARGET")
        ->check(CLI::IsMember({"auto", "v2", "v3", "v4"}))
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
    for (const protocol::LimitInfo& limit : protocol::limit_table())
        if (limit.policy)
            app.add_option("--" + hyphened(limit.name), options.limits.*limit.value,
                           "Limit: " + std::string(limit.text))
                ->check(CLI::Range(std::uint64_t{1}, limit_max))
                ->group("Limits")
                ->capture_default_str();
    app.set_config("--config", "", "Read options from a file as --print-config writes it")
        ->configurable(false);
    app.config_formatter(std::make_shared<ConfigLines>(app));
}

/// The reason why an option cannot be set as this line of a file says; empty when it can.
std::string config_fault(const CLI::ConfigItem& item) {
    if (!item.parents.empty())
        return "sections are not known here; write KEY=VALUE, as raynestd --print-config does";
    Options options;
    Words words;
    CLI::App trial;
    declare(trial, options, words);
    CLI::Option* option = trial.get_option_no_throw("--" + item.name);
    if (option == nullptr || !option->get_configurable())
        return "there is no option '" + item.name + "'; raynestd --print-config lists them";
    try {
        for (const std::string& value : item.inputs) option->add_result(value);
        option->run_callback();
        return "";
    } catch (const CLI::Error& error) {
        const std::string fault = error.what();
        return fault.substr(fault.starts_with("--") ? 2 : 0);
    }
}

std::vector<CLI::ConfigItem> ConfigLines::from_config(std::istream& file) const {
    std::vector<CLI::ConfigItem> read;
    std::string line;
    for (std::size_t number = 1; std::getline(file, line); ++number) {
        std::istringstream alone(line);
        for (CLI::ConfigItem& item : ConfigBase::from_config(alone)) {
            if (const std::string fault = config_fault(item); !fault.empty())
                throw CLI::ConfigError(app_.get_config_ptr()->results().back() + ", line " +
                                       std::to_string(number) + ": " + fault);
            const auto same = std::ranges::find(read, item.name, &CLI::ConfigItem::name);
            if (same == read.end())
                read.push_back(std::move(item));
            else  // CLI11 would take the first only
                same->inputs.insert(same->inputs.end(), item.inputs.begin(), item.inputs.end());
        }
    }
    return read;
}

// Every line explains itself; what has no value stays as a comment, to be filled in.
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
        for (const std::string& value : values) std::cout << name << "=\"" << value << "\"\n";
    }
    std::cout << "\n# Limits of the protocol, not configurable:\n";
    const protocol::Limits limits;
    for (const protocol::LimitInfo& limit : protocol::limit_table())
        if (!limit.policy)
            std::cout << "#   " << limit.name << " = " << limits.*limit.value << "  # "
                      << limit.text << '\n';
}

/// How an option is spelled now that was spelled with underscores; empty where that is no such one.
std::string respelled(const CLI::App& app, const std::string& flag) {
    const std::string now = hyphened(flag);
    const bool old = now != flag && app.get_option_no_throw(now) != nullptr;
    return old ? flag + " is now spelled " + now : "";
}

void refuse_old_spelling(const CLI::App& app, int argc, const char* const* argv) {
    for (int i = 1; i < argc; ++i) {
        const std::string argument = argv[i];
        if (!argument.starts_with("--")) continue;
        const std::string complaint = respelled(app, argument.substr(0, argument.find('=')));
        if (!complaint.empty()) throw CLI::ParseError(complaint, CLI::ExitCodes::ExtrasError);
    }
}

}  // namespace

ParsedOptions parse_options(int argc, const char* const* argv) {
    Options options;
    options.threads = std::clamp(std::thread::hardware_concurrency(), 1U, threads_max);
    options.memory = half_of_memory();
    Words words;

    CLI::App app(
        "Example:\n"
        "  raynestd --listen tcp://127.0.0.1:0 --ready-file /tmp/raynest.json\n\n"
        "raynestd traces rays through instanced scenes for clients.",
        "raynestd");
    bool print = false;
    try {
        declare(app, options, words);
        app.add_flag("--print-config", print, "Print all options and limits, then exit")
            ->configurable(false);
        app.set_version_flag("--version", "raynestd " RAYNEST_VERSION);
        refuse_old_spelling(app, argc, argv);
        app.parse(argc, argv);
        options.socket = to_socket_access(words);
        options.log_level = to_log_level(words.log_level);
        options.cuda_pack = to_cuda_pack(words.cuda);
        if (!print) return {options, 0};
        print_config(app);
        return {std::nullopt, 0};
    } catch (const CLI::Success& answered) {
        return {std::nullopt, app.exit(answered)};
    } catch (const CLI::Error& error) {
        std::cerr << "raynestd: " << error.what() << "; see raynestd --help\n";
        return {std::nullopt, 2};
    }
}

}  // namespace raynest::server
