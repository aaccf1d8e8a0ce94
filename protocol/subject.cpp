#include "protocol/subject.h"

#include "protocol/validate.h"

#include <algorithm>

namespace raynest::protocol {
namespace {

bool is_digit(char c) {
    return c >= '0' && c <= '9';
}

bool is_letter(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}

bool is_hex(char c) {
    return is_digit(c) || (c >= 'a' && c <= 'f') || (c >= 'A' && c <= 'F');
}

/// True for a name such as "CN" or a number such as "2.5.4.3".
bool is_type(std::string_view type) {
    if (type.empty()) return false;
    if (is_digit(type.front()))
        return std::ranges::all_of(type, [](char c) { return is_digit(c) || c == '.'; });
    return is_letter(type.front()) && std::ranges::all_of(type, [](char c) {
               return is_letter(c) || is_digit(c) || c == '-';
           });
}

/// Takes "VALUE" and the separator behind it off `text`. False if it is invalid, or if nothing
/// follows the separator.
bool take_value(std::string_view& text) {
    constexpr std::string_view special = ",+\"\\<>;";
    constexpr std::string_view escapable = ",+\"\\<>;# =";
    if (text.starts_with(' ')) return false;
    bool ends_blank = false;
    while (!text.empty() && text.front() != ',' && text.front() != '+') {
        ends_blank = text.front() == ' ';
        std::size_t size = 1;
        if (text.front() == '\\') {
            if (text.size() >= 2 && escapable.find(text[1]) != std::string_view::npos)
                size = 2;
            else if (text.size() >= 3 && is_hex(text[1]) && is_hex(text[2]))
                size = 3;
            else
                return false;
        } else if (special.find(text.front()) != std::string_view::npos) {
            return false;
        }
        text.remove_prefix(size);
    }
    if (ends_blank) return false;
    if (text.empty()) return true;
    text.remove_prefix(1);
    return !text.empty();
}

}  // namespace

bool is_subject(std::string_view text) {
    if (text.empty() || text.size() > subject_bytes_max || !printable(text)) return false;
    while (!text.empty()) {
        const std::size_t equals = text.find('=');
        if (equals == std::string_view::npos || !is_type(text.substr(0, equals))) return false;
        text.remove_prefix(equals + 1);
        if (!take_value(text)) return false;
    }
    return true;
}

tl::expected<std::vector<std::string>, std::string> split_principals(std::string_view list) {
    std::vector<std::string> names(1);
    for (std::size_t i = 0; i < list.size(); ++i) {
        const bool escapes =
            list[i] == '\\' && i + 1 < list.size() && (list[i + 1] == ',' || list[i + 1] == '\\');
        if (escapes)
            names.back() += list[++i];
        else if (list[i] == ',')
            names.emplace_back();
        else
            names.back() += list[i];
    }
    const auto has_equals = [](const std::string& name) {
        return name.find('=') != std::string::npos;
    };
    const std::string shown = std::string("'").append(list).append("'");
    for (std::size_t i = 0; i < names.size(); ++i) {
        if (names[i].empty()) return tl::unexpected(shown + " has an empty name in it");
        if (i > 0 && has_equals(names[i - 1]) && has_equals(names[i]))
            return tl::unexpected(shown +
                                  " may be one certificate or several: write '\\,' for a "
                                  "comma in a subject, as in CN=robot\\,O=Lab, and give "
                                  "each certificate an option of its own");
        if (has_equals(names[i]) && !is_subject(names[i]))
            return tl::unexpected(std::string("'").append(names[i]) +
                                  "' is not a certificate's subject as `raynest "
                                  "scenes` and the daemon's log show it, such as "
                                  "CN=robot,O=Lab; in a list write '\\,' for its "
                                  "commas and '\\\\' for its backslashes");
    }
    return names;
}

std::string in_list(std::string_view name) {
    std::string text;
    for (const char c : name) {
        if (c == ',' || c == '\\') text += '\\';
        text += c;
    }
    return text;
}

}  // namespace raynest::protocol
