#include "protocol/text.h"

#include <doctest/doctest.h>

#include <cstdint>
#include <initializer_list>
#include <string>

using raynest::protocol::clean_text;
using raynest::protocol::has_hidden_letter;
using raynest::protocol::has_unassigned_letter;
using raynest::protocol::hidden_letter;
using raynest::protocol::percent_code;
using raynest::protocol::single_blanks;

namespace {

/// A code as UTF-8.
std::string letter(std::uint32_t code) {
    const auto part = [code](std::uint32_t shift) { return (code >> shift) & 0x3FU; };
    const auto bytes = [](std::initializer_list<std::uint32_t> codes) {
        std::string text;
        for (const std::uint32_t byte : codes) text += static_cast<char>(byte);
        return text;
    };
    if (code < 0x80) return bytes({code});
    if (code < 0x800) return bytes({0xC0 | code >> 6, 0x80 | part(0)});
    if (code < 0x10000) return bytes({0xE0 | code >> 12, 0x80 | part(6), 0x80 | part(0)});
    return bytes({0xF0 | code >> 18, 0x80 | part(12), 0x80 | part(6), 0x80 | part(0)});
}

}  // namespace

TEST_CASE("a text is cut between two letters, on one line and printable") {
    CHECK(clean_text("abc", 2) == "ab");
    CHECK(clean_text("a\xc3\xa4", 2) == "a");
    CHECK(clean_text("a\xc3\xa4", 3) == "a\xc3\xa4");
    CHECK(clean_text("two\nlines\t\xc3\xa4", 99) == "two lines \xc3\xa4");
    CHECK(clean_text("a\x1b[2J", 9) == "a?[2J");
    CHECK(clean_text("\xff\xfe", 9) == "??");
    CHECK(clean_text("\xc3\xa4\xc2\x9b\xc2\xa1", 9) == "\xc3\xa4?\xc2\xa1");
    CHECK(clean_text("a\xc2\x9b", 2) == "a");
}

TEST_CASE("letters that nobody sees, or that turn others round, are no part of a clean text") {
    for (const char* hidden :
         {"\xc2\xad", "\xd8\x9c", "\xe2\x80\x8b", "\xe2\x80\xa8", "\xe2\x80\xa9", "\xe2\x80\xae",
          "\xe2\x81\xa6", "\xef\xbb\xbf", "\xf0\x9d\x85\xb3", "\xf3\xa0\x80\x81"}) {
        const std::string text = std::string("a") + hidden + "b";
        CAPTURE(text);
        CHECK(hidden_letter(text, 1) == text.size() - 2);
        CHECK(has_hidden_letter(text));
        CHECK(clean_text(text, 99) == "a?b");
    }
    // The same of each range: default-ignorable ones, blanks, noncharacters.
    for (const std::uint32_t code :
         {0xA0U,    0x34FU,   0x115FU,  0x1160U,  0x1680U,   0x17B4U,  0x17B5U,  0x180BU,
          0x180FU,  0x2000U,  0x2003U,  0x200AU,  0x202FU,   0x205FU,  0x2065U,  0x206FU,
          0x2800U,  0x3000U,  0x3164U,  0xFDD0U,  0xFDEFU,   0xFE00U,  0xFE0FU,  0xFFA0U,
          0xFFF0U,  0xFFFEU,  0xFFFFU,  0x13441U, 0x16FE4U,  0x1D159U, 0x1FFFEU, 0x1FFFFU,
          0xE0000U, 0xE0001U, 0xE0100U, 0xE0FFFU, 0x10FFFEU, 0x10FFFFU}) {
        CAPTURE(code);
        CHECK(has_hidden_letter(letter(code)));
    }
    for (const std::uint32_t code :
         {0x20U, 0xA1U, 0x34EU, 0x1161U, 0x180AU, 0x2010U, 0x2801U, 0x3001U, 0x3165U, 0xFDCFU,
          0xFDF0U, 0xFE10U, 0xFFA1U, 0xFFFDU, 0x1FFFDU, 0xE1000U})
        CHECK_FALSE(has_hidden_letter(letter(code)));
    for (const char* seen : {"", "a", "\xc2\xac", "\xc3\xa4", "\xe2\x80\x90", "\xe2\x82\xac",
                             "\xf0\x9f\x98\x80", "\xe2\x80", "\xff"})
        CHECK_FALSE(has_hidden_letter(seen));
}

TEST_CASE(
    "letters that fonts draw alike, because they know none of them, are told apart from others") {
    for (const std::uint32_t code :
         {0x378U, 0xE000U, 0xF8FFU, 0x33480U, 0x40000U, 0xF0000U, 0x10FFFDU}) {
        CAPTURE(code);
        CHECK(has_unassigned_letter("a" + letter(code)));
        CHECK_FALSE(has_hidden_letter(letter(code)));
    }
    for (const std::uint32_t code :
         {0x20U, 0xE4U, 0x377U, 0x20ACU, 0x4E2DU, 0xFB00U, 0x1F600U, 0x20000U}) {
        CAPTURE(code);
        CHECK_FALSE(has_unassigned_letter("a" + letter(code)));
    }
}

TEST_CASE("blanks are made single") {
    CHECK(single_blanks("a b") == "a b");
    CHECK(single_blanks("  a   b ") == "a b");
    CHECK(single_blanks("  ").empty());
}

TEST_CASE("a percent code is two hexadecimal digits after its sign") {
    CHECK(percent_code("%20b") == ' ');
    CHECK(percent_code("%C3") == '\xc3');
    CHECK(percent_code("%00") == '\0');
    for (const char* none : {"", "%", "%4", "%4g", "%-1", "%+1", "% 1", "%x1", "a%20"})
        CHECK_FALSE(percent_code(none));
}
