#include "protocol/frame.h"

#include "tests/golden/examples.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstring>
#include <optional>
#include <vector>

using namespace raynest;
using protocol::Frame;
using protocol::FrameDecoder;
using protocol::Limits;

namespace {

/// Feeds `bytes` in pieces of `piece` bytes; returns the decoded frames.
std::vector<Frame> decode(const std::vector<std::byte>& bytes, std::size_t piece) {
    const Limits limits;
    FrameDecoder decoder(limits);
    std::vector<Frame> frames;
    for (std::size_t at = 0; at < bytes.size();) {
        const std::size_t count = std::min(piece, bytes.size() - at);
        const auto taken = decoder.feed(std::span(bytes).subspan(at, count));
        REQUIRE(taken);
        at += *taken;
        if (decoder.complete()) frames.push_back(decoder.take());
    }
    CHECK(decoder.idle());
    return frames;
}

bool same_bytes(const protocol::Buffer& a, const protocol::Buffer& b) {
    return std::ranges::equal(a.span(), b.span());
}

std::vector<std::byte> all_examples() {
    std::vector<std::byte> stream;
    for (const golden::Example& example : golden::examples()) {
        const std::vector<std::byte> bytes = golden::wire_bytes(example.frame);
        stream.insert(stream.end(), bytes.begin(), bytes.end());
    }
    return stream;
}

}  // namespace

TEST_CASE("buffers of any size are aligned, hold all their bytes, and move") {
    CHECK(protocol::Buffer(0).data() == nullptr);
    CHECK_THROWS_AS(protocol::Buffer(~std::size_t{0}), std::bad_alloc);
    std::vector<protocol::Buffer> buffers;
    for (std::size_t size = 1; size < 300; ++size) {
        buffers.emplace_back(size);
        std::memset(buffers.back().data(), static_cast<int>(size), size);
    }
    for (std::size_t size = 1; size < 300; ++size) {
        protocol::Buffer taken = std::move(buffers[size - 1]);
        CHECK(taken.size() == size);
        CHECK(reinterpret_cast<std::uintptr_t>(taken.data()) % protocol::alignment == 0);
        CHECK(std::ranges::count(taken.span(), static_cast<std::byte>(size)) == size);
        CHECK(buffers[size - 1].size() == 0);
    }
}

TEST_CASE("a header is 32 little-endian bytes") {
    protocol::FrameHeader header;
    header.type = 0x0102;
    header.control_bytes = 0x1112;
    header.block_count = 0x21;
    header.bulk_bytes = 0x40;
    header.request_id = 0x4142434445464748;
    std::byte bytes[protocol::header_bytes];
    protocol::write_header(header, bytes);

    const unsigned char expected[protocol::header_bytes] = {
        'R',  'Y', 'N', '1', 0x02, 0x01, 0, 0, 0x12, 0x11, 0,    0,    0x21, 0,    0,    0,
        0x40, 0,   0,   0,   0,    0,    0, 0, 0x48, 0x47, 0x46, 0x45, 0x44, 0x43, 0x42, 0x41};
    CHECK(std::memcmp(bytes, expected, sizeof expected) == 0);
    CHECK(protocol::read_header(bytes, Limits{}).value() == header);
}

TEST_CASE("a stream in pieces of any size gives the same frames") {
    const std::vector<std::byte> stream = all_examples();
    const std::vector<golden::Example> expected = golden::examples();
    for (const std::size_t piece : {1UL, 2UL, 3UL, 31UL, 32UL, 33UL, 64UL, 1000UL, 1UL << 20}) {
        CAPTURE(piece);
        const std::vector<Frame> frames = decode(stream, piece);
        REQUIRE(frames.size() == expected.size());
        for (std::size_t i = 0; i < frames.size(); ++i) {
            CHECK(frames[i].header == expected[i].frame.header);
            CHECK(same_bytes(frames[i].control, expected[i].frame.control));
            CHECK(same_bytes(frames[i].bulk, expected[i].frame.bulk));
        }
    }
}

TEST_CASE("a frame split in two at any byte is the same frame") {
    for (const golden::Example& example : golden::examples()) {
        const std::vector<std::byte> bytes = golden::wire_bytes(example.frame);
        for (std::size_t cut = 0; cut <= bytes.size(); ++cut) {
            const Limits limits;
            FrameDecoder decoder(limits);
            REQUIRE(decoder.feed(std::span(bytes).first(cut)).value() == cut);
            REQUIRE(decoder.complete() == (cut == bytes.size()));
            REQUIRE(decoder.feed(std::span(bytes).subspan(cut)).value() == bytes.size() - cut);
            REQUIRE(decoder.complete());
            REQUIRE(golden::wire_bytes(decoder.take()) == bytes);
        }
    }
}

TEST_CASE("bulk bytes may be read straight into their place") {
    const Limits limits;
    FrameDecoder decoder(limits);
    std::optional<protocol::FrameHeader> announced;
    decoder.set_admission([&](const protocol::FrameHeader& header) {
        announced = header;
        return protocol::Result<bool>(true);
    });
    CHECK(decoder.room().empty());
    for (const golden::Example& example : golden::examples()) {
        const std::vector<std::byte> bytes = golden::wire_bytes(example.frame);
        const std::size_t head = bytes.size() - example.frame.bulk.size();
        REQUIRE(decoder.feed(std::span(bytes).first(head)).value() == head);
        REQUIRE(announced.has_value());
        CHECK(*announced == example.frame.header);
        REQUIRE(decoder.room().size() == example.frame.bulk.size());
        std::copy(bytes.begin() + static_cast<std::ptrdiff_t>(head), bytes.end(),
                  decoder.room().begin());
        decoder.filled(example.frame.bulk.size());
        REQUIRE(decoder.complete());
        CHECK(golden::wire_bytes(decoder.take()) == bytes);
    }
}

TEST_CASE("an unwanted bulk part takes no memory, and the stream continues after it") {
    const Limits limits;
    const std::vector<golden::Example> examples = golden::examples();
    for (const std::size_t piece : {std::size_t{1}, std::size_t{7}, std::size_t{4096}}) {
        FrameDecoder decoder(limits);
        decoder.set_admission([](const protocol::FrameHeader&) { return false; });
        std::size_t frames = 0;
        const std::vector<std::byte> stream = all_examples();
        for (std::size_t at = 0; at < stream.size();) {
            const std::size_t count = std::min(piece, stream.size() - at);
            at += decoder.feed(std::span(stream).subspan(at, count)).value();
            CHECK(decoder.room().empty());
            if (!decoder.complete()) continue;
            const Frame frame = decoder.take();
            const Frame& sent = examples[frames++].frame;
            REQUIRE(frame.header == sent.header);
            CHECK(same_bytes(frame.control, sent.control));
            CHECK(frame.bulk.size() == 0);
        }
        CHECK(frames == examples.size());
    }
}

TEST_CASE("a refused header ends the stream before its control part comes") {
    const Limits limits;
    FrameDecoder decoder(limits);
    decoder.set_admission([](const protocol::FrameHeader&) -> protocol::Result<bool> {
        return protocol::fail(protocol::Code::quota, "no");
    });
    const std::vector<std::byte> bytes = golden::wire_bytes(golden::examples()[0].frame);
    const auto refused = decoder.feed(std::span(bytes).first(protocol::header_bytes));
    CHECK(refused.error().code == protocol::Code::quota);
}

TEST_CASE("a complete frame waits until it is taken") {
    const std::vector<std::byte> stream = all_examples();
    const Limits limits;
    FrameDecoder decoder(limits);
    const std::size_t first = decoder.feed(stream).value();
    REQUIRE(decoder.complete());
    CHECK(first < stream.size());
    CHECK(decoder.feed(std::span(stream).subspan(first)).value() == 0);
}

TEST_CASE("an error is final") {
    const Limits limits;
    FrameDecoder decoder(limits);
    const std::vector<std::byte> junk(64, std::byte{'x'});
    CHECK(decoder.feed(junk).error().code == protocol::Code::bad_frame);
    const std::vector<std::byte> good = golden::wire_bytes(golden::examples()[1].frame);
    CHECK(decoder.feed(good).error().code == protocol::Code::bad_frame);
}

TEST_CASE("the greeting has a smaller limit than later frames") {
    const std::vector<std::byte> ping =
        golden::wire_bytes(protocol::encode(1, wire::PingT{}).value());
    const Limits limits;
    FrameDecoder decoder(limits);
    decoder.set_frame_bytes_max(ping.size() - 1);
    CHECK(decoder.feed(ping).error().code == protocol::Code::limit_exceeded);

    FrameDecoder lenient(limits);
    lenient.set_frame_bytes_max(ping.size());
    CHECK(lenient.feed(ping).value() == ping.size());
    CHECK(lenient.complete());
}

TEST_CASE("control and bulk parts are 64-byte aligned") {
    for (const Frame& frame : decode(all_examples(), 7)) {
        CHECK(reinterpret_cast<std::uintptr_t>(frame.control.data()) % 64 == 0);
        CHECK(reinterpret_cast<std::uintptr_t>(frame.bulk.data()) % 64 == 0);
    }
}
