#include "client/output/output.h"

#include "client/ground/json.h"
#include "client/ground/text.h"

#include <doctest/doctest.h>

#include <string>

using namespace raynest::client;

TEST_CASE("a text is shown on one line without control characters") {
    CHECK(shown_text("a\x1b[31m\x07\x7f b") == "a?[31m?? b");
    CHECK(shown_text("one\ntwo\tthree\r") == "one two three ");
    CHECK(shown_text("Bäume 木") == "Bäume 木");
    CHECK(shown_text("\xc2\x9b"
                     "31m ä") == "?31m ä");
    CHECK(shown_text("\xff") == "?");
}

TEST_CASE("a document is shown with all its texts and names so") {
    const Json document = {{"a\x1b", {"b\x07", Json{{"c", "d\x7f"}}, 1, nullptr}}};
    CHECK(shown_json(document) == Json{{"a?", {"b?", Json{{"c", "d?"}}, 1, nullptr}}});
    CHECK(shown_json(Json("\x1b")) == Json("?"));
}

TEST_CASE("JSON escapes every control character and reads back the same") {
    std::string all = "Bäume 木 \xc3\x80";
    for (char c = 1; c < 0x20; ++c) all += c;
    all += '\x7f';
    for (unsigned c1 = 0x80; c1 < 0xa0; ++c1) all += {'\xc2', static_cast<char>(c1)};
    all += "\xc2\xa0";
    const std::string text = json_text(Json{{all, all}});
    for (std::size_t i = 0; i < text.size(); ++i) {
        const auto byte = static_cast<unsigned char>(text[i]);
        CHECK(byte >= 0x20);
        CHECK(byte != 0x7f);
        if (byte == 0xc2) CHECK(static_cast<unsigned char>(text[i + 1]) >= 0xa0);
    }
    CHECK(Json::parse(text) == Json{{all, all}});
    CHECK(json_text(Json("\x7f")) == "\"\\u007f\"");
}
