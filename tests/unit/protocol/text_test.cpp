#include "protocol/text.h"

#include <doctest/doctest.h>

#include <initializer_list>
#include <string>

using raynest::protocol::clean_text;
using raynest::protocol::has_hidden_letter;
using raynest::protocol::hidden_letter;
using raynest::protocol::percent_code;

TEST_CASE("a text is cut between two letters, on one line and printable") {
    CHECK(clean_text("abc", 2) == "ab");
    CHECK(clean_text("a\xc3\xa4", 2) == "a");
    CHECK(clean_text("a\xc3\xa4", 3) == "a\xc3\xa4");
    CHECK(clean_text("two\nlines\t\xc3\xa4", 99) == "two lines \xc3\xa4");
    CHECK(clean_text("a\x1b[2J", 9) == "a?[2J");
    CHECK(clean_text("\xff\xfe", 9) == "??");
    CHECK(clean_text("\xc3\xa4\xc2\x9b\xc2\xa0", 9) == "\xc3\xa4?\xc2\xa0");
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
    for (const char* seen : {"", "a", "\xc2\xac", "\xc3\xa4", "\xe2\x80\x90", "\xe2\x82\xac",
                             "\xf0\x9f\x98\x80", "\xe2\x80", "\xff"})
        CHECK_FALSE(has_hidden_letter(seen));
}

TEST_CASE("a percent code is two hexadecimal digits after its sign") {
    CHECK(percent_code("%20b") == ' ');
    CHECK(percent_code("%C3") == '\xc3');
    CHECK(percent_code("%00") == '\0');
    for (const char* none : {"", "%", "%4", "%4g", "%-1", "%+1", "% 1", "%x1", "a%20"})
        CHECK_FALSE(percent_code(none));
}
