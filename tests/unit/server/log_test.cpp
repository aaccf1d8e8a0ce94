#include "server/ground/log.h"

#include <doctest/doctest.h>

namespace raynest::server {
namespace {

TEST_CASE("letters that nobody sees are escaped") {
    CHECK(format_event("e", {{"a", "x\xe2\x80\xaez"}}) == "e a=\"x\\xe2\\x80\\xaez\"");
}

TEST_CASE("plain values are unquoted, others are quoted") {
    CHECK(format_event("loaded", {{"scene", "forest"}, {"epoch", "1"}}) ==
          "loaded scene=forest epoch=1");
    CHECK(format_event("e", {{"a", "two words"}}) == "e a=\"two words\"");
    CHECK(format_event("e", {{"a", ""}}) == "e a=\"\"");
}

TEST_CASE("no value can forge a line, a field or an escape sequence") {
    CHECK(format_event("e", {{"a", "x\n2026 error forged"}}) == "e a=\"x\\x0a2026 error forged\"");
    CHECK(format_event("e", {{"a", "x\r\t\x1b[2J"}}) == "e a=\"x\\x0d\\x09\\x1b[2J\"");
    CHECK(format_event("e", {{"a", "x level=error"}}) == "e a=\"x level=error\"");
    CHECK(format_event("e", {{"a", "b=c"}}) == "e a=\"b=c\"");
    CHECK(format_event("e", {{"a", "\" b=\"c"}}) == "e a=\"\\\" b=\\\"c\"");
    CHECK(format_event("e", {{"a", "back\\slash"}}) == "e a=\"back\\\\slash\"");
    CHECK(format_event("e", {{"a", "{}%s{0}"}}) == "e a={}%s{0}");
}

TEST_CASE("control characters beyond ASCII, which terminals obey too, are escaped") {
    CHECK(format_event("e", {{"a",
                              "x\xC2\x9B"
                              "2J"}}) == "e a=\"x\\xc2\\x9b2J\"");
    CHECK(format_event("e", {{"a", "caf\xC3\xA9"}}) == "e a=\"caf\xC3\xA9\"");
}

TEST_CASE("as JSON, no value can forge a member, a line or an escape sequence") {
    CHECK(format_json_event("loaded", {{"scene", "forest"}, {"epoch", "1"}}) ==
          R"("event":"loaded","scene":"forest","epoch":"1")");
    CHECK(format_json_event("e", {{"a", "x\n\",\"level\":\"error"}}) ==
          R"("event":"e","a":"x\n\",\"level\":\"error")");
    CHECK(format_json_event("e", {{"a", "\x1b[2J\x7F\xC2\x9B"}}) ==
          R"("event":"e","a":"\u001b[2J\u007f\u009b")");
    CHECK(format_json_event("e", {{"a", "\xFF"}}) == R"("event":"e","a":"\ufffd")");
}

TEST_CASE("lines on behalf of a request name it, and the innermost scope counts") {
    const RequestScope outer({17, 0});
    CHECK(format_event("e", {}) == "e connection=17");
    {
        const RequestScope inner({17, 0x5f3a91c00001});
        CHECK(format_event("e", {}) == "e connection=17 request_id=5f3a91c00001");
        CHECK(format_json_event("e", {}) ==
              R"("event":"e","connection":"17","request_id":"5f3a91c00001")");
    }
    CHECK(format_event("e", {}) == "e connection=17");
}

}  // namespace
}  // namespace raynest::server
