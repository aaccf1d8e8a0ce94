#include "protocol/text.h"

#include "protocol/validate.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>
#include <system_error>
#include <utility>

namespace raynest::protocol {

namespace {

/// First and last code of each range of Unicode 15's property Default_Ignorable_Code_Point
/// (DerivedCoreProperties.txt), its categories Cf, Zl, Zp and Zs (UnicodeData.txt) but the blank, the
/// noncharacters U+FDD0 to U+FDEF, and what is drawn empty: the Braille pattern, the Khitan filler, the
/// blanks of hieroglyphs, the notehead. is_hidden() knows the others.
constexpr std::array<std::pair<char32_t, char32_t>, 32> hidden_codes = {{
    {0xA0, 0xA0},       {0xAD, 0xAD},       {0x34F, 0x34F},     {0x600, 0x605},
    {0x61C, 0x61C},     {0x6DD, 0x6DD},     {0x70F, 0x70F},     {0x890, 0x891},
    {0x8E2, 0x8E2},     {0x115F, 0x1160},   {0x1680, 0x1680},   {0x17B4, 0x17B5},
    {0x180B, 0x180F},   {0x2000, 0x200F},   {0x2028, 0x202F},   {0x205F, 0x206F},
    {0x2800, 0x2800},   {0x3000, 0x3000},   {0x3164, 0x3164},   {0xFDD0, 0xFDEF},
    {0xFE00, 0xFE0F},   {0xFEFF, 0xFEFF},   {0xFFA0, 0xFFA0},   {0xFFF0, 0xFFFB},
    {0x110BD, 0x110BD}, {0x110CD, 0x110CD}, {0x13430, 0x13442}, {0x16FE4, 0x16FE4},
    {0x1BCA0, 0x1BCA3}, {0x1D159, 0x1D159}, {0x1D173, 0x1D17A}, {0xE0000, 0xE0FFF},
}};

constexpr auto unassigned_codes = std::to_array<std::pair<char32_t, char32_t>>({
#include "protocol/lists/unassigned.inc"
});

bool is_in(const auto& ranges, char32_t code) {
    return std::ranges::any_of(
        ranges, [code](const auto& range) { return range.first <= code && code <= range.second; });
}

bool is_hidden(char32_t code) {
    // The last two codes of each plane are noncharacters.
    return (code & 0xFFFEU) == 0xFFFEU || is_in(hidden_codes, code);
}

/// Returns the letter of several bytes that begins at `at`, and their number; 0 and 0 where none does.
std::pair<char32_t, std::size_t> long_letter(std::string_view text, std::size_t at) {
    const auto lead = static_cast<unsigned char>(text[at]);
    if (lead < 0xC2 || lead > 0xF4) return {};
    const std::size_t length = lead < 0xE0 ? 2 : lead < 0xF0 ? 3 : 4;
    if (text.size() - at < length) return {};
    char32_t code = lead & (0xFFU >> (length + 1));
    for (std::size_t k = 1; k < length; ++k)
        code = code << 6 | (static_cast<unsigned char>(text[at + k]) & 0x3FU);
    return {code, length};
}

}  // namespace

std::size_t hidden_letter(std::string_view text, std::size_t at) {
    const auto [code, length] = long_letter(text, at);
    return is_hidden(code) ? length : 0;
}

bool has_hidden_letter(std::string_view text) {
    for (std::size_t at = 0; at < text.size(); ++at)
        if (hidden_letter(text, at) != 0) return true;
    return false;
}

bool has_unassigned_letter(std::string_view text) {
    for (std::size_t at = 0; at < text.size(); ++at)
        if (is_in(unassigned_codes, long_letter(text, at).first)) return true;
    return false;
}

std::string single_blanks(std::string_view text) {
    std::string single;
    for (const char c : text)
        if (c != ' ' || (!single.empty() && single.back() != ' ')) single += c;
    if (!single.empty() && single.back() == ' ') single.pop_back();
    return single;
}

std::string clean_text(std::string_view text, std::size_t bytes_max) {
    const std::string_view kept = text.substr(0, bytes_max);
    std::string clean;
    clean.reserve(kept.size());
    for (std::size_t i = 0; i < kept.size(); ++i) {
        const char c = kept[i];
        // In UTF-8, the controls U+0080 to U+009F are C2 80 to C2 9F.
        const bool is_c1 = c == '\xC2' && i + 1 < kept.size() && (kept[i + 1] & '\xE0') == '\x80';
        if (const std::size_t hidden = hidden_letter(kept, i); hidden != 0) {
            clean += '?';
            i += hidden - 1;
            continue;
        }
        if (is_c1) ++i;
        if (c == '\n' || c == '\r' || c == '\t')
            clean += ' ';
        else
            clean += is_c1 || (c >= 0 && c < 0x20) || c == 0x7F ? '?' : c;
    }
    // A cut inside a letter leaves up to three bytes of it.
    for (int i = 0; i < 3 && text.size() > bytes_max && !printable(clean); ++i) clean.pop_back();
    if (!printable(clean))
        std::replace_if(
            clean.begin(), clean.end(), [](char c) { return c < 0; }, '?');
    return clean;
}

std::optional<char> percent_code(std::string_view text) {
    if (text.size() < 3 || text[0] != '%') return std::nullopt;
    unsigned char byte = 0;
    const char* const end = text.data() + 3;
    const auto read = std::from_chars(text.data() + 1, end, byte, 16);
    if (read.ec != std::errc{} || read.ptr != end) return std::nullopt;
    return static_cast<char>(byte);
}

bool printable(std::string_view text) {
    for (std::size_t i = 0; i < text.size();) {
        const auto lead = static_cast<unsigned char>(text[i]);
        const std::size_t length = lead < 0x80 ? 1 : lead < 0xE0 ? 2 : lead < 0xF0 ? 3 : 4;
        if (lead < 0x20 || lead == 0x7F || (lead >= 0x80 && lead < 0xC2) || lead > 0xF4)
            return false;
        if (text.size() - i < length) return false;
        std::uint32_t code = length == 1 ? lead : lead & (0xFFU >> (length + 1));
        for (std::size_t k = 1; k < length; ++k) {
            const auto byte = static_cast<unsigned char>(text[i + k]);
            if ((byte & 0xC0U) != 0x80U) return false;
            code = code << 6 | (byte & 0x3FU);
        }
        // The C1 controls, overlong forms, surrogates, and what lies beyond Unicode.
        if ((code >= 0x80 && code < 0xA0) || (length == 3 && code < 0x800) ||
            (length == 4 && code < 0x10000) || (code >= 0xD800 && code < 0xE000) || code > 0x10FFFF)
            return false;
        i += length;
    }
    return true;
}

std::string bytes_text(std::uint64_t bytes) {
    static constexpr std::array units = {"B", "KiB", "MiB", "GiB", "TiB"};
    auto value = static_cast<double>(bytes);
    std::size_t unit = 0;
    for (; value >= 1024 && unit + 1 < units.size(); ++unit) value /= 1024;
    std::array<char, 32> text;
    std::snprintf(text.data(), text.size(), unit == 0 ? "%.0f %s" : "%.1f %s", value, units[unit]);
    return text.data();
}

}  // namespace raynest::protocol
