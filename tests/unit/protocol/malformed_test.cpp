#include "tests/golden/malformed.h"

#include "tests/golden/examples.h"

#include <doctest/doctest.h>

#include <cstring>
#include <set>
#include <string>

using namespace raynest;
using protocol::Code;

namespace {

struct Reaction {
    Code code = Code::internal;
    bool closes = false;
};

/// Returns the reaction of a daemon that only decodes and opens; `internal` if it accepts.
Reaction react(const std::vector<std::byte>& bytes) {
    const protocol::Limits limits;
    protocol::FrameDecoder decoder(limits);
    const auto taken = decoder.feed(bytes);
    if (!taken) return {taken.error().code, true};
    if (!decoder.complete()) return {};
    const protocol::Frame frame = decoder.take();
    if (protocol::message_known(frame.header.type) && !protocol::sent_by_client(frame.header.type))
        return {Code::bad_frame, true};
    const auto opened = golden::open_any(frame);
    return opened ? Reaction{} : Reaction{opened.error().code, false};
}

}  // namespace

TEST_CASE("every malformed frame is refused with its code") {
    const std::vector<golden::Malformed> rows = golden::malformed_frames();
    CHECK(rows.size() >= 200);
    MESSAGE(rows.size(), " malformed frames");
    std::set<std::string> names;
    for (const golden::Malformed& row : rows) {
        CAPTURE(row.name);
        CHECK(names.insert(row.name).second);
        const Reaction reaction = react(row.bytes);
        CHECK(protocol::error_info(reaction.code).name == protocol::error_info(row.code).name);
        CHECK(reaction.closes == row.closes);
    }
}

TEST_CASE("a message whose control part is cut anywhere never opens as an invalid message") {
    std::size_t refused = 0;
    std::size_t cuts = 0;
    for (const golden::Example& example : golden::examples()) {
        for (std::size_t size = 0; size < example.frame.control.size(); ++size) {
            protocol::Frame cut;
            cut.header = example.frame.header;
            cut.header.control_bytes = static_cast<std::uint32_t>(size);
            cut.header.block_count = 0;
            cut.header.bulk_bytes = 0;
            cut.control = protocol::Buffer(size);
            if (size != 0) std::memcpy(cut.control.data(), example.frame.control.data(), size);
            ++cuts;
            if (!golden::open_any(cut)) ++refused;
        }
    }
    // A cut message that still opens has only lost padding at its end.
    CHECK(cuts - refused < cuts / 50);
}

TEST_CASE("a control part with any one byte changed opens or is refused, and is read safely") {
    std::size_t opened = 0;
    for (const golden::Example& example : golden::examples()) {
        protocol::Frame damaged;
        damaged.header = example.frame.header;
        damaged.control = protocol::Buffer(example.frame.control.size());
        damaged.bulk = protocol::Buffer(example.frame.bulk.size());
        for (std::size_t i = 0; i < damaged.control.size(); ++i) {
            for (const std::byte flip : {std::byte{0x01}, std::byte{0x80}, std::byte{0xFF}}) {
                std::memcpy(damaged.control.data(), example.frame.control.data(),
                            damaged.control.size());
                damaged.control.data()[i] ^= flip;
                if (golden::open_any(damaged)) ++opened;
            }
        }
    }
    CHECK(opened > 0);
}

TEST_CASE("half a million tables in 32 KiB are refused by their number") {
    const std::vector<std::byte> bomb = golden::table_bomb();
    protocol::Frame frame;
    frame.header.type = static_cast<std::uint16_t>(wire::Message::VariantList);
    frame.header.control_bytes = static_cast<std::uint32_t>(bomb.size());
    frame.control = protocol::Buffer(bomb.size());
    std::memcpy(frame.control.data(), bomb.data(), bomb.size());

    const auto opened = golden::open_any(frame);
    REQUIRE(!opened);
    CHECK(opened.error().code == Code::bad_frame);
    // Check the bomb: nothing else is wrong with it.
    const auto verifies = [&](flatbuffers::uoffset_t tables_max) {
        return flatbuffers::Verifier(reinterpret_cast<const std::uint8_t*>(bomb.data()),
                                     bomb.size(), 64, tables_max)
            .VerifyBuffer<wire::VariantList>(nullptr);
    };
    CHECK(verifies(1'000'000));
    CHECK_FALSE(verifies(400'000));
}
