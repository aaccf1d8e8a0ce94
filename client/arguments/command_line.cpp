#include "client/arguments/command_line.h"

#include <CLI/CLI.hpp>

#include <algorithm>
#include <cctype>
#include <map>
#include <memory>
#include <set>
#include <string_view>
#include <utility>

namespace raynest::client {
namespace {

/// Says in words what CLI11 says of an option group: "Exactly 1 option from [--ray,--rays] is
/// required", of two "but 2 were given" too.
std::string plain_words(std::string what) {
    constexpr std::string_view begin = "Exactly 1 option from [";
    const std::size_t end = what.find(']');
    if (!what.starts_with(begin) || end == std::string::npos) return what;
    std::string names = what.substr(begin.size(), end - begin.size());
    for (std::size_t at = 0; (at = names.find(',', at)) != std::string::npos; at += 2)
        names.insert(at + 1, " ");
    return "one of " + names + what.substr(end + 1);
}

/// Refuses "", which a script passes for a variable that it forgot to set.
std::string complain_if_empty(const std::string& text) {
    return text.empty() ? "must not be empty" : "";
}

using Texts = std::vector<std::string>;

/// Returns what CLI11 calls with the texts of an option.
std::function<void(const Texts&)> throwing(const std::string& name, CommandLine::ReadAll read) {
    return [name, read = std::move(read)](const Texts& texts) {
        if (const auto taken = read(texts); !taken)
            throw CLI::ValidationError(name, taken.error().message);
    };
}

/// CLI11 names the options that one needs or excludes before its text, as if they were its type: they
/// stand behind the text here.
class HelpFormatter final : public CLI::Formatter {
    std::string make_option_opts(const CLI::Option* option) const override {
        const std::string whole = CLI::Formatter::make_option_opts(option);
        return whole.substr(0, std::min(whole.find(" Needs:"), whole.find(" Excludes:")));
    }
    std::string make_option_desc(const CLI::Option* option) const override {
        return CLI::Formatter::make_option_desc(option) + named("; with ", option->get_needs()) +
               named("; not with ", option->get_excludes());
    }
    static std::string named(const char* begin, const std::set<CLI::Option*>& options) {
        std::set<std::string> names;  // the order of addresses is another one in each run
        for (const CLI::Option* option : options) names.insert(option->get_name());
        std::string all;
        for (const std::string& name : names) all += (all.empty() ? begin : ", ") + name;
        return all;
    }
};

}  // namespace

const Option& Option::required() const {
    option_->required();
    return *this;
}
const Option& Option::needs(const Option& other) const {
    option_->needs(other.option_);
    return *this;
}
const Option& Option::excludes(const Option& other) const {
    option_->excludes(other.option_);
    return *this;
}
const Option& Option::one_of(const std::vector<std::string>& words) const {
    option_->check(CLI::IsMember(words));
    return *this;
}
const Option& Option::environment_name(const std::string& name) const {
    option_->envname(name);
    return *this;
}
const Option& Option::type_name(const std::string& name) const {
    option_->type_name(name);
    return *this;
}
const Option& Option::filled() const {
    option_->check(CLI::Validator(complain_if_empty, ""));
    return *this;
}
const Option& Option::hidden() const {
    option_->group("");
    return *this;
}

std::string CommandLine::number_type(const std::string& what, bool has_range) {
    const std::size_t from = what.find(" from "), to = what.find(" to ", from);
    const std::size_t unit = what.rfind(' ', from - 1) + 1;
    std::string type = what.substr(unit, from - unit);
    std::ranges::transform(type, type.begin(),
                           [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
    if (has_range)
        type += " in [" + what.substr(from + 6, to - from - 6) + ", " + what.substr(to + 4) + "]";
    return type;
}

Option CommandLine::add_option(const std::string& name, std::string& value,
                               const std::string& text) {
    return Option(app_->add_option(name, value, text));
}
Option CommandLine::add_options(const std::string& name, std::vector<std::string>& values,
                                const std::string& text) {
    return Option(app_->add_option(name, values, text));
}
Option CommandLine::add_flag(const std::string& name, bool& value, const std::string& text) {
    return Option(app_->add_flag(name, value, text));
}
Option CommandLine::add_parsed(const std::string& name, Read read, const std::string& text) {
    return Option(app_->add_option_function<std::string>(
        name,
        [name, read = std::move(read)](const std::string& value) {
            const std::string complaint = read(value);
            if (!complaint.empty()) throw CLI::ValidationError(name, complaint);
        },
        text));
}
Option CommandLine::add_all(const std::string& name, ReadAll read, const std::string& text) {
    return Option(app_->add_option_function<Texts>(name, throwing(name, std::move(read)), text)
                      ->take_all()
                      ->allow_extra_args(false));
}
Option CommandLine::add_each(const std::string& name, ReadEach read, const std::string& text) {
    return add_all(
        name,
        [read = std::move(read)](const Texts& texts) -> Result<void> {
            for (const std::string& one : texts)
                if (auto taken = read(one); !taken) return taken;
            return {};
        },
        text);
}
Option CommandLine::add_in_order(const std::string& name, Read read, const std::string& text) {
    const auto take = [name, read = std::move(read)](const std::string& given) {
        if (const std::string fault = read(given); !fault.empty())
            throw CLI::ValidationError(name, fault);
    };
    return Option(app_->add_option_function<std::string>(name, take, text)
                      ->trigger_on_parse()
                      ->multi_option_policy(CLI::MultiOptionPolicy::TakeLast)
                      ->allow_extra_args(false));
}
Option CommandLine::add_words(const std::string& name, ReadAll read, const std::string& text) {
    return Option(app_->add_option_function<Texts>(name, throwing(name, std::move(read)), text)
                      ->expected(1, -1));
}
Option CommandLine::find(const std::string& name) const {
    return Option(app_->get_option(name));
}
CommandLine CommandLine::add_choice(const std::string& title, const std::string& text) {
    CLI::Option_group* const group = app_->add_option_group(title, text);
    group->require_option(1);
    return CommandLine(group);
}
void CommandLine::at_end(std::function<std::string()> check) {
    app_->parse_complete_callback([check = std::move(check)] {
        if (const std::string complaint = check(); !complaint.empty())
            throw CLI::ValidationError(complaint);
    });
}
void CommandLine::footer(const std::string& text) {
    app_->footer(text);
}

struct Program::Commands {
    explicit Commands(Program::Texts own)
        : texts(std::move(own)),
          app(texts.description, "raynest") {
        app.footer(texts.footer);
        app.formatter(std::make_shared<HelpFormatter>());
        app.require_subcommand(1);
        app.set_version_flag("--version", texts.version);
    }
    /// Returns the help of the chosen command, or of the program; it begins with an example.
    [[nodiscard]] std::string help() const {
        const std::vector<CLI::App*> chosen = app.get_subcommands();
        if (chosen.empty()) return texts.examples + app.help();
        return "Example:\n  raynest " + examples.at(chosen[0]) + "\n\n" +
               chosen[0]->help("raynest");
    }
    /// Returns a message about the first unused word, which is an unknown option or command, or "".
    /// CLI11 alone might complain of a missing option instead.
    [[nodiscard]] std::string complaint() const {
        const std::vector<std::string> words = app.remaining(true);
        for (const std::string& word : words)
            if (word.starts_with("--")) return "there is no option " + word;
        for (const std::string& word : words)
            if (word.find('=') != std::string::npos && !app.get_subcommands().empty())
                return "'" + word + "' stands alone: repeat --set before each NAME=VALUE";
        if (!app.get_subcommands().empty() || words.empty()) return "";
        if (words[0].starts_with('-')) return "there is no option " + words[0];
        std::string names;
        for (const CLI::App* sub : app.get_subcommands({}))
            names += (names.empty() ? "" : ", ") + sub->get_name();
        return "there is no subcommand '" + words[0] + "'; there are " + names;
    }

    Program::Texts texts;
    CLI::App app;
    std::map<const CLI::App*, std::string> examples;
};

Program::Program(Texts texts) : commands_(std::make_unique<Commands>(std::move(texts))) {}

Program::~Program() = default;

CommandLine Program::line() const {
    return CommandLine(&commands_->app);
}

void Program::add_command(const std::string& name, const std::string& example,
                          const std::string& text, const std::function<void(CommandLine&)>& declare,
                          std::function<void()> choose) {
    CLI::App* const sub = commands_->app.add_subcommand(name, text);
    CommandLine line(sub);
    declare(line);
    for (CLI::Option* option : sub->get_options())
        option->check(CLI::Validator(complain_if_empty, ""));
    sub->fallthrough();
    sub->final_callback(std::move(choose));
    commands_->examples[sub] = example;
}

Result<std::string> Program::parse(int argc, const char* const* argv) {
    CLI::App& app = commands_->app;
    try {
        app.parse(argc, argv);
    } catch (const CLI::CallForHelp&) {
        const std::string complaint = commands_->complaint();
        if (!complaint.empty()) return refuse(complaint);
        return commands_->help();
    } catch (const CLI::CallForVersion& version) {
        return std::string(version.what()) + "\n";
    } catch (const CLI::RequiredError& error) {
        const std::string complaint = commands_->complaint();
        if (!complaint.empty()) return refuse(complaint);
        if (app.get_subcommands().empty()) {
            Failure advice = failure(Exit::usage, commands_->texts.first_steps);
            advice.has_lines = true;
            return tl::unexpected<Failure>(std::move(advice));
        }
        return refuse(plain_words(error.what()));
    } catch (const CLI::ParseError& error) {
        const std::string complaint = commands_->complaint();
        return refuse(complaint.empty() ? error.what() : complaint);
    }
    return std::string();
}

tl::unexpected<Failure> Program::refuse(const std::string& complaint) const {
    const std::vector<CLI::App*> chosen = commands_->app.get_subcommands();
    const std::string name = chosen.empty() ? "" : " " + chosen[0]->get_name();
    return fail(Exit::usage, complaint + "; see: raynest" + name + " --help");
}

}  // namespace raynest::client
