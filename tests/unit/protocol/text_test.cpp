#include "protocol/text.h"

#include <doctest/doctest.h>

#include <initializer_list>

using raynest::protocol::clean_text;
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

TEST_CASE("a percent code is two hexadecimal digits after its sign") {
    CHECK(percent_code("%20b") == ' ');
    CHECK(percent_code("%C3") == '\xc3');
    CHECK(percent_code("%00") == '\0');
    for (const char* none : {"", "%", "%4", "%4g", "%-1", "%+1", "% 1", "%x1", "a%20"})
        CHECK_FALSE(percent_code(none));
}
