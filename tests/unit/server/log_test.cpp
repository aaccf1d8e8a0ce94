#include "server/log.h"

#include <doctest/doctest.h>

namespace raynest::server {
namespace {

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

}  // namespace
}  // namespace raynest::server
