#include "client/output.h"

#include "client/interrupt.h"

#include <poll.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <iostream>
#include <utility>

namespace raynest::client {
namespace {

bool is_number(const std::string& text) {
    return text == "-" || (!text.empty() && (std::isdigit(static_cast<unsigned char>(text[0])) ||
                                             (text[0] == '-' && text.size() > 1)));
}

/// Counts letters, not bytes: names may be UTF-8.
std::size_t letters(const std::string& text) {
    return static_cast<std::size_t>(std::count_if(text.begin(), text.end(), [](char c) {
        return (static_cast<unsigned char>(c) & 0xC0) != 0x80;
    }));
}

}  // namespace

void end_if_unread() {
    pollfd out{STDOUT_FILENO, POLLOUT, 0};
    if (::poll(&out, 1, 0) == 1 && (out.revents & POLLERR) != 0) {
        ::signal(SIGPIPE, SIG_DFL);
        ::raise(SIGPIPE);
    }
}

Result<void> check_stdout() {
    errno = 0;
    std::cout.flush();
    if (std::cout) return {};
    const int why = errno;  // 0 if an earlier write failed
    if (interrupted()) return fail(Exit::interrupted, "interrupted");
    end_if_unread();
    return fail(Exit::failed, "cannot write stdout" +
                                  (why == 0 ? "" : std::string(": ") + std::strerror(why)));
}

std::string json_text(const Json& value) {
    const std::string plain = value.dump(-1, ' ', false, Json::error_handler_t::replace);
    std::string text;
    for (std::size_t i = 0; i < plain.size(); ++i) {
        const auto byte = static_cast<unsigned char>(plain[i]);
        // In UTF-8, U+0080 to U+009F are C2 80 to C2 9F.
        const bool is_c1 = byte == 0xC2 && static_cast<unsigned char>(plain[i + 1]) < 0xA0;
        if (byte != 0x7F && !is_c1) {
            text += plain[i];
            continue;
        }
        if (is_c1) ++i;
        std::array<char, 8> escape{};
        std::snprintf(escape.data(), escape.size(), "\\u%04x", static_cast<unsigned char>(plain[i]));
        text += escape.data();
    }
    return text;
}

void print_json(const Json& value, std::ostream& to) {
    to << json_text(value) << '\n';
}

std::string shown_text(std::string_view text) {
    return protocol::clean_text(text, text.size());
}

Json shown_json(const Json& value) {
    if (value.is_string()) return shown_text(value.get<std::string>());
    if (!value.is_structured()) return value;
    Json shown = value.is_array() ? Json::array() : Json::object();
    for (const auto& item : value.items())
        if (value.is_array())
            shown.push_back(shown_json(item.value()));
        else
            shown[shown_text(item.key())] = shown_json(item.value());
    return shown;
}

void print_note(std::string_view note) {
    std::cerr << "raynest: " << shown_text(note) << '\n';
}

void print_table(const std::vector<std::vector<std::string>>& rows) {
    std::vector<std::size_t> widths;
    for (const auto& row : rows) {
        widths.resize(std::max(widths.size(), row.size()), 0);
        for (std::size_t i = 0; i < row.size(); ++i)
            widths[i] = std::max(widths[i], letters(row[i]));
    }
    // Align a column of numbers to the right, with its title.
    std::vector<bool> right(widths.size(), rows.size() > 1);
    for (std::size_t r = 1; r < rows.size(); ++r)
        for (std::size_t i = 0; i < rows[r].size(); ++i)
            if (!is_number(rows[r][i])) right[i] = false;
    for (const auto& row : rows) {
        std::string line;
        for (std::size_t i = 0; i < row.size(); ++i) {
            const std::string blanks(widths[i] - letters(row[i]), ' ');
            line += (i == 0 ? "" : "  ") + (right[i] ? blanks + row[i] : row[i] + blanks);
        }
        line.erase(line.find_last_not_of(' ') + 1);
        std::cout << line << '\n';
    }
}

std::string grouped(std::uint64_t number) {
    std::string text = std::to_string(number);
    for (std::size_t at = text.size(); at > 3;) {
        at -= 3;
        text.insert(at, ",");
    }
    return text;
}

std::string seconds_text(double seconds) {
    std::array<char, 32> text;
    std::snprintf(text.data(), text.size(), "%.3f s", seconds);
    return text.data();
}

std::string age_text(double seconds) {
    static constexpr std::array<std::pair<double, char>, 3> units = {
        {{86400, 'd'}, {3600, 'h'}, {60, 'm'}}};
    for (const auto& [unit, letter] : units)
        if (seconds >= unit) return std::to_string(static_cast<long>(seconds / unit)) + letter;
    return std::to_string(static_cast<long>(seconds)) + 's';
}

namespace {

template <class Number>
std::string shortest_text(Number value) {
    if (!std::isfinite(value)) return "null";
    std::array<char, 32> text;
    const Number shown = value + Number{0};  // without -0
    const auto [end, error] = std::to_chars(text.data(), text.data() + text.size(), shown);
    return std::string(text.data(), end);
}

}  // namespace

std::string float_text(float value) {
    return shortest_text(value);
}

std::string world_text(float relative, double origin) {
    return origin == 0 ? float_text(relative) : shortest_text(double{relative} + origin);
}

}  // namespace raynest::client
