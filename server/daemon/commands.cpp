#include "server/daemon/commands.h"

#include "protocol/subject.h"
#include "protocol/text.h"
#include "server/daemon/check_command.h"
#include "server/daemon/draw_command.h"
#include "server/security/certificates.h"
#include "server/security/file_place.h"
#include "server/security/quotas.h"
#include "server/security/tokens.h"

#include <CLI/CLI.hpp>
#include <sys/file.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <functional>
#include <iomanip>
#include <iostream>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {
namespace {

namespace fs = std::filesystem;

constexpr int exit_failed = 1;
constexpr int exit_usage = 2;
constexpr int exit_unknown = 5;

/// How the subject of a certificate is written, for messages.
constexpr const char* subject_form =
    "a certificate's subject: write it as the daemon's log shows it, such as CN=robot,O=Lab; it is "
    "printed by: openssl x509 -in FILE -noout -subject -nameopt RFC2253,-esc_msb";

int failed(const std::string& why, int code = exit_failed) {
    // A word of the command line may hold line ends: the message is one line.
    constexpr std::size_t bytes_max = 4096;
    std::cerr << "raynestd: " << protocol::clean_text(why, bytes_max) << '\n';
    return code;
}

int done() {
    return std::cout.flush() ? 0 : failed("cannot write stdout");
}

/// Returns the token file of root, or else of this user.
fs::path default_tokens() {
    if (geteuid() == 0) return "/etc/raynest/tokens";
    // getenv() is safe here: no other thread has started yet.
    const char* config = std::getenv("XDG_CONFIG_HOME");  // NOLINT(concurrency-mt-unsafe)
    if (config != nullptr && config[0] == '/') return fs::path(config) / "raynest" / "tokens";
    const char* home = std::getenv("HOME");  // NOLINT(concurrency-mt-unsafe)
    return fs::path(home == nullptr ? "." : home) / ".config" / "raynest" / "tokens";
}

/// Longest time until a token expires: its end must fit a clock of nanoseconds, which ends in 2262.
constexpr long expires_days_max = 36'500;

/// Parses "90s", "15m", "12h" or "30d"; nothing if it is invalid or over expires_days_max.
std::optional<std::chrono::seconds> parse_period(const std::string& text) {
    constexpr std::string_view units = "smhd";
    constexpr std::array<long, 4> lengths = {1, 60, 3600, 86400};
    long count = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), count);
    const std::size_t unit = text.empty() ? units.npos : units.find(text.back());
    if (error != std::errc{} || end != text.data() + text.size() - 1 || unit == units.npos ||
        count < 1 || count > expires_days_max * lengths.back() / lengths[unit])
        return std::nullopt;
    return std::chrono::seconds(count * lengths[unit]);
}

// ---- tls ----------------------------------------------------------------------------------------

int tls_init(const fs::path& folder, const std::vector<std::string>& hosts) {
    std::vector<std::string> names = own_names();
    for (const std::string& host : hosts)
        if (std::find(names.begin(), names.end(), host) == names.end()) names.push_back(host);
    if (const auto made = make_certificates(folder, names); !made)
        return failed(made.error().message);
    using Files = CertificateFiles;
    const auto path = [&](const char* name) { return (folder / name).string(); };
    std::cout << "certificate of";
    for (const std::string& name : names) std::cout << ' ' << name;
    std::cout << "\n\nServe:   raynestd --listen tls://0.0.0.0:31062 --tls-cert "
              << path(Files::server) << " --tls-key " << path(Files::server_key)
              << " --tokens FILE\nClients: raynest --ca " << path(Files::ca)
              << " --server tls://HOST:31062 scenes\nGive clients " << Files::ca
              << " alone. Let the daemon's user read " << Files::server << " and "
              << Files::server_key << ", but never " << Files::ca_key << ". Keep " << Files::ca_key
              << " off the network; `raynestd tls renew " << folder.string()
              << "` needs it within 397 days.\n";
    return done();
}

int tls_renew(const fs::path& folder) {
    const auto renewed = renew_certificates(folder);
    if (!renewed) return failed(renewed.error().message);
    std::cout << "renewed for " << renewed->days << " days";
    if (renewed->ends_with_ca)
        std::cout
            << ", when their CA ends: make another before with raynestd tls init DIR, and give "
               "clients its "
            << CertificateFiles::ca;
    std::cout << "; a running daemon reads them after: kill -HUP PID\n";
    return done();
}

// ---- token --------------------------------------------------------------------------------------

/// Why a command changes nothing.
struct Refusal {
    int code;
    std::string why;
};

/// Reads the file, lets `edit` change the rows, and writes it. Two commands at a time take turns.
int edit_tokens(const fs::path& given,
                const std::function<std::optional<Refusal>(TokenTable&)>& edit) {
    std::error_code error;
    const fs::path file = fs::absolute(given, error);
    if (fs::create_directories(file.parent_path(), error))
        fs::permissions(file.parent_path(), fs::perms::owner_all, error);
    // A daemon may watch the target of a link.
    const auto place = FilePlace::find(file);
    if (!place) return failed(place.error().message);
    const Fd held = place->open_folder();
    if (held.get() < 0 || ::flock(held.get(), LOCK_EX) != 0)
        return failed(place->path().parent_path().string() + ": " + std::strerror(errno) +
                      (errno == EACCES ? "; run this command as root" : ""));
    auto table = TokenTable::read_to_edit(*place);
    if (!table) return failed(table.error().message);
    if (const auto refused = edit(*table)) return failed(refused->why, refused->code);
    const auto written = table->write(*place);
    return written ? 0 : failed(written.error().message);
}

struct TokenWords {
    std::string name, subject, role = "user", expires, quota;
    bool unlisted = false;
    fs::path file = default_tokens();

    /// The principal that the command is about.
    [[nodiscard]] const std::string& principal() const { return subject.empty() ? name : subject; }
};

int token_add(const TokenWords& words) {
    // A scene shared with this name would be everybody's.
    if (words.name == "public")
        return failed("'public' means everybody in load --share; choose another name", exit_usage);
    const auto now = WallClock::now();
    TokenRow row;
    row.name = words.principal();
    row.role = *parse_role(words.role);
    row.quota = *parse_quota(words.quota);
    // The file has whole seconds.
    if (!words.expires.empty())
        row.expires = std::chrono::ceil<std::chrono::seconds>(now + *parse_period(words.expires));
    std::string token;
    if (words.subject.empty()) {
        token = new_token();
        row.hash = hash_token(token);
    } else {
        row.kind = TokenRow::Kind::certificate;
    }
    bool was_expired = false;
    const int code = edit_tokens(words.file, [&](TokenTable& table) -> std::optional<Refusal> {
        const TokenRow* known = table.find_name(row.name);
        was_expired = known != nullptr && known->expires && *known->expires <= now;
        if (known != nullptr && known->kind != TokenRow::Kind::shut_out && !was_expired)
            return Refusal{exit_failed, "'" + row.name + "' exists in " + words.file.string() +
                                            "; revoke it first, or choose another name"};
        table.put(row);
        return std::nullopt;
    });
    if (code != 0) return code;
    std::cout << row.name << (was_expired ? " had expired, and" : "") << " may connect as "
              << role_name(row.role) << " (" << words.file.string() << ")\n";
    if (!token.empty())
        std::cout << "This token is shown only now; keep it secret:\n" << token << '\n';
    return done();
}

std::string date_of(WallClock::time_point time) {
    const std::time_t at = WallClock::to_time_t(time);
    std::tm parts{};
    gmtime_r(&at, &parts);
    std::ostringstream text;
    text << std::put_time(&parts, "%Y-%m-%dT%H:%M:%SZ");
    return text.str();
}

int token_list(const TokenWords& words) {
    const auto table = TokenTable::read(words.file, Reader::command);
    if (!table) return failed(table.error().message);
    const auto now = WallClock::now();
    std::cout << "NAME\tROLE\tEXPIRES\tQUOTA\n";
    for (const TokenRow& row : table->rows()) {
        const std::string quota = to_text(row.quota);
        const bool is_shut_out = row.kind == TokenRow::Kind::shut_out;
        std::cout << row.name << '\t' << (is_shut_out ? "none" : role_name(row.role)) << '\t'
                  << (row.expires ? date_of(*row.expires) : "never")
                  << (row.expires && *row.expires <= now ? " (expired)" : "") << '\t'
                  << (quota.empty() ? "-" : quota) << '\n';
    }
    return done();
}

int token_revoke(const TokenWords& words) {
    const std::string& name = words.principal();
    const bool is_certificate = !words.subject.empty();
    bool was_there = false;
    const int code = edit_tokens(words.file, [&](TokenTable& table) -> std::optional<Refusal> {
        was_there = table.erase(name);
        // Rows of other words match no certificate, and may be taken away.
        if (is_certificate && !protocol::is_subject(name))
            return was_there ? std::nullopt
                             : std::optional(Refusal{exit_usage, std::string("'").append(name) +
                                                                     "' is not " + subject_form});
        if (!was_there && !is_certificate)
            return Refusal{exit_unknown, "no such token: '" + name + "' in " + words.file.string() +
                                             "; see raynestd token list"};
        if (!was_there && !words.unlisted)
            return Refusal{exit_unknown,
                           "no row of a certificate '" + name + "' in " + words.file.string() +
                               "; see raynestd token list. To shut out one that has no row, add "
                               "--unlisted, with its subject just as the daemon's log shows it"};
        // A certificate is let in by its CA: without a row it would have the role user.
        if (is_certificate) table.put({TokenRow::Kind::shut_out, name, Role::viewer, {}, {}, {}});
        return std::nullopt;
    });
    if (code != 0) return code;
    if (was_there)
        std::cout << name << " is revoked; a running daemon ends its connections within a second\n";
    else
        std::cout
            << "certificates that the daemon's log shows as " << name
            << " are shut out, and no others; a running daemon ends their connections within a "
               "second\n";
    return done();
}

// ---- command line -------------------------------------------------------------------------------

/// Adds a check with a message of its own. `good` tells whether a text is valid.
template <class Good>
void check(CLI::Option* option, Good good, const std::string& wanted) {
    option->check(CLI::Validator(
        [good, wanted](const std::string& text) {
            return good(text) ? std::string() : "'" + text + "' is not " + wanted;
        },
        ""));
}

bool is_host(const std::string& text) {
    return !text.empty() && text.size() <= 253 && std::all_of(text.begin(), text.end(), [](char c) {
        return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '.' || c == '-' ||
               c == ':' || c == '*';
    });
}

void declare_tls(CLI::App& app, std::function<int()>& action) {
    CLI::App* tls = app.add_subcommand("tls", "Make and renew certificates");
    tls->require_subcommand(1);
    const auto folder = std::make_shared<fs::path>();
    const auto hosts = std::make_shared<std::vector<std::string>>();
    CLI::App* init = tls->add_subcommand(
        "init", "Make a private CA, a server certificate and a client certificate in DIR");
    init->add_option("DIR", *folder, "Folder; nothing in it is overwritten")->required();
    check(init->add_option("--host", *hosts,
                           "Host name or IP address besides those of this host, repeatable"),
          is_host, "a host name or an IP address");
    init->callback([&action, folder, hosts] {
        action = [folder, hosts] { return tls_init(*folder, *hosts); };
    });
    CLI::App* renew =
        tls->add_subcommand("renew", "Sign the certificates of DIR anew, for the same names");
    renew->add_option("DIR", *folder, "Folder that `tls init` has made")->required();
    renew->callback([&action, folder] { action = [folder] { return tls_renew(*folder); }; });
}

void declare_token(CLI::App& app, std::function<int()>& action) {
    CLI::App* token = app.add_subcommand("token", "Give and take access");
    token->require_subcommand(1);
    const auto words = std::make_shared<TokenWords>();
    const auto add_file = [&](CLI::App* command) {
        command->add_option("--tokens", words->file, "Token file")->capture_default_str();
    };
    const auto add_name = [&](CLI::App* command, bool (*good_subject)(std::string_view)) {
        CLI::Option* name = command->add_option("NAME", words->name, "Name of the principal");
        check(name, is_token_name,
              "a name of 1 to 64 letters, digits and -._ that begins with a letter");
        CLI::Option* subject =
            command->add_option("--cert", words->subject,
                                "Subject of a client certificate in place of NAME, such as "
                                "\"CN=robot,O=Lab\"");
        check(subject, good_subject, subject_form);
        name->excludes(subject);
        command->parse_complete_callback([name, subject] {
            if (name->count() + subject->count() == 0) throw CLI::RequiredError("NAME or --cert");
        });
    };
    CLI::App* add = token->add_subcommand(
        "add", "Make a token and print it, alone on the last line; or admit a certificate");
    add_name(add, protocol::is_subject);
    add_file(add);
    check(
        add->add_option("--role", words->role, "viewer, user or admin")->capture_default_str(),
        [](const std::string& text) { return parse_role(text).has_value(); },
        "a role: viewer, user or admin");
    check(
        add->add_option("--expires", words->expires, "Time until it expires: 90s, 12h, 30d"),
        [](const std::string& text) { return parse_period(text).has_value(); },
        "a time such as 90s, 12h or 30d, at most " + std::to_string(expires_days_max) +
            "d; leave it out for a token that never expires");
    add->add_option("--quota", words->quota,
                    quota_keys() + "; any of them with commas between, bytes also as 20G")
        ->check(CLI::Validator(
            [](const std::string& text) {
                const auto quota = read_quota(text);
                return quota ? std::string() : quota.error().message;
            },
            ""));
    add->callback([&action, words] { action = [words] { return token_add(*words); }; });
    CLI::App* list = token->add_subcommand("list", "List names, roles and expiry");
    add_file(list);
    list->callback([&action, words] { action = [words] { return token_list(*words); }; });
    CLI::App* revoke =
        token->add_subcommand("revoke", "Take access away, and end the connections that have it");
    add_name(revoke, [](std::string_view text) { return !text.empty(); });
    add_file(revoke);
    revoke->add_flag("--unlisted", words->unlisted,
                     "With --cert: shut out a certificate that has no row, and so the role user");
    revoke->callback([&action, words] { action = [words] { return token_revoke(*words); }; });
}

/// Returns what is wrong with the word after `tls` or `token`; empty if it is one of its commands.
std::string command_fault(std::string_view group, std::string_view word) {
    const std::string names = group == "tls" ? "init, renew" : "add, list, revoke";
    const bool is_known = (", " + names + ",").find(", " + std::string(word) + ",") != names.npos;
    if (is_known || word == "-h" || word == "--help") return "";
    const bool is_missing = word.empty() || word.starts_with('-');
    return (is_missing
                ? std::string(group) + " needs a command"
                : "there is no command '" + std::string(group) + " " + std::string(word) + "'") +
           "; use one of: " + names;
}

/// A command for a state folder: its name, and words that are folders.
struct StateCommand {
    std::string_view name;
    std::size_t words;
    const char* usage;
    int (*run)(const std::vector<const char*>& words, Form form);
};
constexpr std::array<StateCommand, 4> state_commands = {{
    {"check", 1, "raynestd check DIR looks at a state folder that no daemon uses",
     [](const auto& words, Form form) { return check_state(words[0], form); }},
    {"backup", 2,
     "raynestd backup DIR NEW copies the state folder DIR, which a daemon may use, to the new "
     "folder NEW; raynestd restore brings it back",
     [](const auto& words, Form form) { return back_up_state(words[0], words[1], form); }},
    {"restore", 2,
     "raynestd restore BACKUP DIR replaces the state folder DIR, while no daemon uses it, by a "
     "copy "
     "of BACKUP, which raynestd backup made",
     [](const auto& words, Form form) { return restore_state(words[0], words[1], form); }},
    {"gc", 1,
     "raynestd gc DIR removes what no scene of a state folder needs, while no daemon uses it",
     [](const auto& words, Form form) { return remove_state_garbage(words[0], form); }},
}};

}  // namespace

std::optional<int> run_command(int argc, const char* const* argv) {
    const std::string_view word = argc > 1 ? argv[1] : "";
    for (const StateCommand& command : state_commands) {
        if (word != command.name) continue;
        std::vector<const char*> words(argv + 2, argv + argc);
        const bool is_json =
            std::erase_if(words, [](const char* w) { return std::string_view(w) == "--json"; }) > 0;
        const std::string usage = std::string(command.usage) + "; --json prints JSON";
        const auto is_help = [](const std::string_view w) { return w == "-h" || w == "--help"; };
        if (std::ranges::any_of(words, is_help)) {
            std::cout << usage << '\n';
            return done();
        }
        const bool is_usage = words.size() != command.words ||
                              std::ranges::any_of(words, [](auto* w) { return w[0] == '-'; });
        if (is_usage) return failed(usage, exit_usage);
        return command.run(words, is_json ? Form::json : Form::text);
    }
    if (word == "draw") return draw_heat_map(std::cin, std::cout, std::cerr);
    if (word != "tls" && word != "token") return std::nullopt;
    if (const std::string fault = command_fault(word, argc > 2 ? argv[2] : ""); !fault.empty())
        return failed(fault + "; see raynestd " + std::string(word) + " --help", exit_usage);
    CLI::App app("", "raynestd");
    std::function<int()> action;
    declare_tls(app, action);
    declare_token(app, action);
    try {
        app.parse(argc, argv);
        return action();
    } catch (const CLI::Success& answered) {
        app.exit(answered);
        return done();
    } catch (const CLI::Error& error) {
        return failed(std::string(error.what()) + "; see raynestd " + std::string(word) + " --help",
                      exit_usage);
    }
}

}  // namespace raynest::server
