#include "protocol/validate.h"

#include "protocol/control.h"
#include "tests/golden/examples.h"
#include "tests/golden/full.h"

#include <doctest/doctest.h>

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

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

TEST_CASE("every text of every message is checked") {
    std::size_t texts = 0;
    for (const wire::Message type : golden::message_types()) {
        const golden::FullMessage full = golden::full_message(type);
        CAPTURE(protocol::message_name(full.frame.header.type));
        const auto opened = golden::open_any(full.frame);
        CHECK_MESSAGE(opened.has_value(), (opened ? "" : opened.error().message));
        for (std::size_t i = 0; i < full.texts.size(); ++i, ++texts) {
            CAPTURE(full.texts[i]);
            const auto spoilt = golden::open_any(golden::full_message(type, i).frame);
            REQUIRE(!spoilt);
            CHECK(protocol::error_info(spoilt.error().code).name == "INVALID_FIELD");
        }
    }
    CHECK(texts > 80);
}

TEST_CASE("the lists of a SceneList are equally long") {
    const auto full = [] {
        wire::SceneListT list;
        list.names = list.hashes = list.owners = list.shares = list.states = {"a"};
        list.epochs = list.instanced_triangles = list.bytes = list.age_ms = list.idle_ms = {1};
        list.holders = {1};
        return list;
    };
    const auto is_valid = [](const wire::SceneListT& list) {
        return protocol::open<wire::SceneList>(*protocol::encode(1, list)).has_value();
    };
    CHECK(is_valid(full()));
    for (const auto list :
         {&wire::SceneListT::epochs, &wire::SceneListT::instanced_triangles,
          &wire::SceneListT::bytes, &wire::SceneListT::age_ms, &wire::SceneListT::idle_ms}) {
        auto spoilt = full();
        (spoilt.*list).clear();
        CHECK_FALSE(is_valid(spoilt));
    }
    for (const auto list : {&wire::SceneListT::hashes, &wire::SceneListT::owners,
                            &wire::SceneListT::shares, &wire::SceneListT::states}) {
        auto spoilt = full();
        (spoilt.*list).emplace_back("b");
        CHECK_FALSE(is_valid(spoilt));
    }
    auto spoilt = full();
    spoilt.holders = {1, 2};
    CHECK_FALSE(is_valid(spoilt));
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

TEST_CASE("misaligned 64-bit numbers that the verifier accepts are refused") {
    bool met_misaligned = false;
    for (int shift = 0; shift < 2; ++shift) {
        // A vector that claims two elements of 8 bytes, with the alignment of four elements of 4
        // bytes.
        flatbuffers::FlatBufferBuilder builder;
        const auto name = builder.CreateString("name");
        builder.StartVector(4, 4);
        for (std::uint32_t i = 0; i < 4; ++i) builder.PushElement(i);
        const flatbuffers::Offset<flatbuffers::Vector<double>> values(builder.EndVector(2));
        // This string lies between the start of the message and the vector.
        builder.CreateString(shift == 0 ? "abc" : "abcdefg");
        const auto names = builder.CreateVector(std::vector{name, name});
        builder.Finish(wire::CreateStatistics(builder, names, values));
        protocol::Frame frame;
        frame.header.type = static_cast<std::uint16_t>(wire::Message::Statistics);
        frame.control = protocol::Buffer(builder.GetSize());
        std::memcpy(frame.control.data(), builder.GetBufferPointer(), builder.GetSize());

        const auto* root = flatbuffers::GetRoot<wire::Statistics>(frame.control.data());
        const auto* data = protocol::present(root->values()).Data();
        const bool aligned = reinterpret_cast<std::uintptr_t>(data) % 8 == 0;
        const auto opened = protocol::open<wire::Statistics>(frame);
        CHECK(opened.has_value() == aligned);
        if (!aligned) CHECK(opened.error().code == protocol::Code::bad_frame);
        met_misaligned = met_misaligned || !aligned;
    }
    CHECK(met_misaligned);
}
