#include "protocol/validate.h"

#include "protocol/control.h"
#include "tests/golden/examples.h"

#include <doctest/doctest.h>

#include <string>

using namespace raynest;
using protocol::printable;

TEST_CASE("printable text is well-formed UTF-8 without control characters") {
    CHECK(printable(""));
    CHECK(printable("forest-12 ~"));
    CHECK(printable("Äpfel, 木, 🌲"));
    CHECK(printable("\xf4\x8f\xbf\xbf"));
    for (const std::string& bad :
         {std::string("\n"), std::string("\t"), std::string("\x7f"), std::string("a\0b", 3),
          std::string("\x80"), std::string("\xc2"), std::string("\xc0\x80"),
          std::string("\xe2\x82"), std::string("\xe0\x80\x80"), std::string("\xed\xbf\xbf"),
          std::string("\xf0\x80\x80\x80"), std::string("\xf5\x80\x80\x80"), std::string("\xff"),
          std::string("\xc2\x9b")}) {
        CAPTURE(bad.size());
        CHECK(!printable(bad));
    }
}

TEST_CASE("every example is valid") {
    for (const golden::Example& example : golden::examples()) {
        CAPTURE(example.name);
        const auto opened = golden::open_any(example.frame);
        CHECK_MESSAGE(opened.has_value(), (opened ? "" : opened.error().message));
    }
}

TEST_CASE("a complaint names the field and the limit") {
    wire::RenderT render;
    render.job = std::make_unique<wire::JobT>();
    render.job->scene = "forest";
    render.width = 20000;
    const auto frame = protocol::encode(1, render);
    REQUIRE(frame);
    const auto opened = protocol::open<wire::Render>(*frame);
    REQUIRE(!opened);
    CHECK(opened.error().message == "width is 20000, over picture_side_max = 16384");
}
