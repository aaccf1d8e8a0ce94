// Text messages of the WebSocket: JSON, and nothing else that their parser would take.
#include "server/http/json_tokens.h"

#include "protocol/control.h"
#include "server/http/websocket_messages.h"

#include <doctest/doctest.h>

#include <string>
#include <string_view>

namespace raynest::server {
namespace {

using protocol::Code;

/// Returns `each` so many times, in a list.
std::string list_of(std::size_t count, std::string_view each) {
    std::string text;
    for (std::size_t i = 0; i < count; ++i) text.append(i == 0 ? "" : ",").append(each);
    return '[' + text + ']';
}

std::string table_of(std::string_view values) {
    return R"(Query 1 {"job":{"scene":"s","tables":[{"name":"a","values":)" + std::string(values) +
           "}]}}";
}

TEST_CASE("what JSON has is let through, and nothing else") {
    for (const char* const text : {"", "{}", " \t\r\n[ ] ", "true", "[true,false,null]", "0", "-0",
                                   "10", "-1.5", "0.25", "1e5", "1E-300", "12.5e+07", R"("")",
                                   R"("sin(1) // 'x' /* \" \\ \u0041 é")", R"({"a":[{"b":-1}]})"}) {
        CAPTURE(text);
        CHECK(fault_of_json(text) == "");
    }
    using std::string_view_literals::operator""sv;
    for (const std::string_view text :
         {"sin(1)"sv,   "[rad(1)]"sv, "{a:1}"sv,  "'a'"sv,        "[f32]"sv,  "nan"sv,    "inf"sv,
          "-inf"sv,     "True"sv,     "nul"sv,    "truesin(1)"sv, "// a"sv,   "{}/**/"sv, "+1"sv,
          ".5"sv,       "1."sv,       "1.e5"sv,   "1e"sv,         "1e+"sv,    "-"sv,      "0x10"sv,
          "1f"sv,       "\""sv,       "\"\\\""sv, "\"a\nb\""sv,   "\"\0\""sv, "\0"sv,     "\f"sv,
          "\xc2\xa0"sv, "$"sv,        ";"sv,      "(1)"sv}) {
        CAPTURE(text);
        CHECK(fault_of_json(text) != "");
    }
}

TEST_CASE("the tokens of a text are counted, however they are written") {
    CHECK(fault_of_json(list_of(2047, R"("")")) == "");
    CHECK(fault_of_json(list_of(2048, R"("")")) != "");
    CHECK(fault_of_json(list_of(4095, "[]")) == "");
    CHECK(fault_of_json(list_of(4096, "[]")) != "");
    CHECK(fault_of_json(list_of(256 + 8, "{}")) == "");
    CHECK(fault_of_json(list_of(256 + 9, "{}")) != "");
    CHECK(fault_of_json(list_of(10'001, "1")) == "");
    CHECK(fault_of_json(list_of(10'002, "1")) != "");
    // A text in quotes is one token, whatever it holds.
    CHECK(fault_of_json('"' + std::string(60'000, ',') + std::string(60'000, '[') + '"') == "");
}

TEST_CASE("a text message that is no JSON is damaged, and what is counts is read") {
    const auto code_of = [](const std::string& message) {
        const auto read = read_text_message(message);
        return read ? Code{} : read.error().error.code;
    };
    CHECK(code_of(table_of("[0.5,\"1e-30\",\"nan\"]")) == Code{});
    CHECK(code_of(table_of("[sin(1)]")) == Code::bad_frame);
    CHECK(code_of("Info 1 {\"scene\":'s'}") == Code::bad_frame);
    CHECK(code_of("Info 1 {\"scene\":\"s\"}//") == Code::bad_frame);
    CHECK(code_of("Info 1 {\"scene\":\"s\"") == Code::bad_frame);
    CHECK(code_of("Upload 1 {\"blocks\":[{\"name\":\"a\",\"dtype\":\"f32\"}]}") == Code{});
    CHECK(code_of("Upload 1 {\"blocks\":[{\"name\":\"a\",\"dtype\":f32}]}") == Code::bad_frame);
}

}  // namespace
}  // namespace raynest::server
