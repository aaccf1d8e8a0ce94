// How commands declare their options. command_line.cpp alone uses CLI11, whose header is large.
#pragma once

#include "client/ground/failure.h"

#include <charconv>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <vector>

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace raynest::client {

/// An option that was added. Each call returns the option itself.
class Option {
public:
    explicit Option(CLI::Option* option) : option_(option) {}

    const Option& required() const;
    const Option& needs(const Option& other) const;
    const Option& excludes(const Option& other) const;
    const Option& one_of(const std::vector<std::string>& words) const;
    /// Takes the value of an environment variable where the option is left out.
    const Option& environment_name(const std::string& name) const;
    /// Sets the word that help has for the value.
    const Option& type_name(const std::string& name) const;
    /// Refuses "", as options of commands do.
    const Option& filled() const;
    /// Leaves the option out of help.
    const Option& hidden() const;

private:
    CLI::Option* option_;
};

inline constexpr std::uint64_t any_whole = std::numeric_limits<std::uint64_t>::max();

/// The options of the program, or of one of its commands. They are written to what they were added
/// with, which must live until the command line is parsed.
class CommandLine {
public:
    explicit CommandLine(CLI::App* app) : app_(app) {}

    /// Adds an option that takes a text; a name without dashes is a word that stands by itself.
    Option add_option(const std::string& name, std::string& value, const std::string& text);
    /// The same with any number of words.
    Option add_options(const std::string& name, std::vector<std::string>& values,
                       const std::string& text);
    Option add_flag(const std::string& name, bool& value, const std::string& text);
    /// Adds an option whose text is parsed by `read`, which returns what is wrong, or "".
    using Read = std::function<std::string(const std::string&)>;
    Option add_parsed(const std::string& name, Read read, const std::string& text);
    /// Adds an option that may be repeated; `read` takes all texts at once.
    using ReadAll = std::function<Result<void>(const std::vector<std::string>&)>;
    Option add_all(const std::string& name, ReadAll read, const std::string& text);
    /// The same; `read` takes one text at a time.
    using ReadEach = std::function<Result<void>(const std::string&)>;
    Option add_each(const std::string& name, ReadEach read, const std::string& text);
    /// Adds an option that may be repeated; `read` returns what is wrong, or "". Several such
    /// options are read in the order in which they stand on the command line.
    Option add_in_order(const std::string& name, Read read, const std::string& text);
    /// Adds an option with one or more words behind it.
    Option add_words(const std::string& name, ReadAll read, const std::string& text);

    /// Adds a number from `least` to `most`; `what` is the text for messages, as "a number of seconds
    /// from 1 to 9". CLI11's own parser would read -1 and 2^70 as 2^64 - 1, and its ranges accept NaN.
    template <class Number>
    Option add_number(const std::string& name, Number& value, Number least, Number most,
                      const std::string& what, const std::string& text) {
        const auto read = [&value, least, most, what](const std::string& digits) -> std::string {
            const char* last = digits.data() + digits.size();
            const auto [end, error] = std::from_chars(digits.data(), last, value);
            const bool good =
                error == std::errc{} && end == last && value >= least && value <= most;
            return good ? "" : "'" + digits + "' is not " + what;
        };
        const bool is_bounded = most != std::numeric_limits<Number>::max();
        return add_parsed(name, read, text).type_name(number_type(what, is_bounded));
    }
    template <class Whole>
    Option add_whole(const std::string& name, Whole& value, Whole least, Whole most,
                     const std::string& text) {
        return add_number(
            name, value, least, most,
            "a whole number from " + std::to_string(least) + " to " + std::to_string(most), text);
    }

    /// Returns the option of this name, which was added before.
    [[nodiscard]] Option find(const std::string& name) const;
    /// Adds options of which exactly one must be given.
    [[nodiscard]] CommandLine add_choice(const std::string& title, const std::string& text);
    /// Sets the check of all options together, which returns what is wrong, or "". A command has
    /// one.
    void at_end(std::function<std::string()> check);
    /// Sets the text at the end of help.
    void footer(const std::string& text);

private:
    /// Returns "SECONDS in [1, 9]" for "a number of seconds from 1 to 9", without range "SECONDS".
    static std::string number_type(const std::string& what, bool has_range);

    CLI::App* app_;
};

/// A program with commands.
class Program {
public:
    struct Texts {
        std::string description, version;
        std::string examples;     ///< before the help of the whole program
        std::string first_steps;  ///< the answer to a command line without a command
        std::string footer;       ///< at the end of help
    };
    explicit Program(Texts texts);
    ~Program();
    Program(const Program&) = delete;

    /// Returns the options that stand before the command.
    [[nodiscard]] CommandLine line() const;
    /// Adds a command, whose options `declare` adds; `choose` is called if it is the chosen one.
    void add_command(const std::string& name, const std::string& example, const std::string& text,
                     const std::function<void(CommandLine&)>& declare,
                     std::function<void()> choose);
    /// Returns a text to print instead of running the command: help or the version; else "".
    Result<std::string> parse(int argc, const char* const* argv);
    /// Returns the failure of a command line, with the help to look at.
    [[nodiscard]] tl::unexpected<Failure> refuse(const std::string& complaint) const;

private:
    struct Commands;
    std::unique_ptr<Commands> commands_;
};

}  // namespace raynest::client
