#include "tests/golden/malformed.h"

#include "protocol/control.h"
#include "tests/golden/examples.h"
#include "tests/golden/malformed_table.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <functional>
#include <memory>
#include <span>
#include <string_view>
#include <utility>

namespace raynest::golden {
namespace {

using protocol::Buffer;

std::vector<std::byte> bytes_of(std::string_view text) {
    std::vector<std::byte> bytes(text.size());
    std::memcpy(bytes.data(), text.data(), text.size());
    bytes.resize(std::max(bytes.size(), protocol::header_bytes), std::byte{'\n'});
    return bytes;
}

Frame with_control(Frame frame, std::vector<std::byte> control) {
    frame.control = Buffer(control.size());
    std::copy(control.begin(), control.end(), frame.control.data());
    frame.header.control_bytes = static_cast<std::uint32_t>(control.size());
    return frame;
}

// ---- not this protocol, or a header that cannot be believed

void add_foreign_bytes(Table& table) {
    using namespace std::string_view_literals;
    const std::array foreign = {
        std::pair{"an HTTP request", "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"sv},
        std::pair{"an HTTP/2 preface", "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"sv},
        std::pair{"a TLS hello", "\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"sv},
        std::pair{"a Redis ping", "*1\r\n$4\r\nPING\r\n"sv},
        std::pair{"an SSH banner", "SSH-2.0-OpenSSH_9.2\r\n"sv},
        std::pair{"zeros", "\0\0\0\0\0\0\0\0"sv},
        std::pair{"ones", "\xff\xff\xff\xff\xff\xff\xff\xff"sv},
        std::pair{"the next protocol", "RYN2"sv},
        std::pair{"the magic backwards", "1NYR"sv},
        std::pair{"the magic in lower case", "ryn1"sv},
        std::pair{"a JSON object", "{\"method\":\"query\"}"sv},
    };
    for (const auto& [name, text] : foreign) table.lost(name, bytes_of(text), Code::bad_frame);

    const Frame ping = protocol::encode(1, wire::PingT{}).value();
    for (std::size_t bit = 0; bit < 32; ++bit) {
        std::vector<std::byte> bytes = wire_bytes(ping);
        bytes[bit / 8] ^= std::byte{1} << (bit % 8);
        table.lost("bit " + std::to_string(bit) + " of the magic flipped", std::move(bytes),
                   Code::bad_frame);
    }
}

void add_bad_headers(Table& table) {
    FrameHeader good;
    good.type = static_cast<std::uint16_t>(wire::Message::Ping);
    good.control_bytes = 16;
    good.request_id = 1;

    for (unsigned bit = 0; bit < 16; ++bit) {
        FrameHeader header = good;
        header.flags = static_cast<std::uint16_t>(1U << bit);
        table.lost("flag " + std::to_string(bit), header, Code::bad_frame);
    }
    for (const std::uint32_t bytes : {65537U, 65600U, 1U << 20, 1U << 31, 0xFFFFFFFFU}) {
        FrameHeader header = good;
        header.control_bytes = bytes;
        table.lost("a control part of " + std::to_string(bytes), header, Code::limit_exceeded);
    }
    constexpr unsigned long long frame_max = 64ULL << 20;
    for (const std::uint64_t bytes :
         {frame_max, frame_max + 64, 1ULL << 31, 1ULL << 32, (1ULL << 32) + 64, 1ULL << 62,
          1ULL << 63, ~0ULL - 63, ~0ULL}) {
        FrameHeader header = good;
        header.bulk_bytes = bytes;
        header.block_count = 1;
        table.lost("a bulk part of " + std::to_string(bytes), header, Code::limit_exceeded);
    }
    for (const std::uint64_t bytes : {1ULL, 32ULL, 63ULL, 65ULL, 4095ULL}) {
        FrameHeader header = good;
        header.bulk_bytes = bytes;
        header.block_count = 1;
        table.lost("an unpadded bulk part of " + std::to_string(bytes), header, Code::bad_frame);
    }
    for (const std::uint32_t blocks : {65U, 256U, 1U << 31, 0xFFFFFFFFU}) {
        FrameHeader header = good;
        header.block_count = blocks;
        table.lost(std::to_string(blocks) + " blocks", header, Code::limit_exceeded);
    }
    FrameHeader header = good;
    header.bulk_bytes = 64;
    table.lost("a bulk part without blocks", header, Code::bad_frame);
}

void add_unknown_types(Table& table) {
    const Frame ping = protocol::encode(1, wire::PingT{}).value();
    for (const unsigned type : {0U, 4U, 5U, 6U, 7U, 22U, 23U, 31U, 63U, 65U, 127U, 128U, 200U, 255U,
                                256U, 257U, 1000U, 32768U, 65535U}) {
        Frame frame =
            with_control(Frame{}, {ping.control.span().begin(), ping.control.span().end()});
        frame.header.type = static_cast<std::uint16_t>(type);
        frame.header.request_id = 1;
        table.kept("message type " + std::to_string(type), frame, Code::unknown_type);
    }
    // A client that sends a message of daemons has lost track of the conversation.
    for (const Example& example : examples()) {
        if (protocol::sent_by_client(example.frame.header.type)) continue;
        FrameHeader header = example.frame.header;
        header.block_count = 0;
        header.bulk_bytes = 0;
        const std::span<const std::byte> control = example.frame.control.span();
        Frame frame = with_control(Frame{}, {control.begin(), control.end()});
        frame.header = header;
        table.lost("a client that sends " + example.name, wire_bytes(frame), Code::bad_frame);
    }
}

// ---- a control part that is no message

void add_bad_controls(Table& table) {
    for (const Example& example : examples()) {
        if (!protocol::sent_by_client(example.frame.header.type)) continue;
        if (example.name == "Hello") continue;  // the greeting is over
        const std::span<const std::byte> control = example.frame.control.span();
        const auto add = [&](const std::string& what, std::vector<std::byte> bytes) {
            Frame frame = with_control(Frame{}, {});
            frame.header = example.frame.header;
            frame.header.request_id = query_id;
            frame.header.block_count = 0;
            frame.header.bulk_bytes = 0;
            table.kept(example.name + " " + what, with_control(std::move(frame), std::move(bytes)),
                       Code::bad_frame);
        };
        add("without a control part", {});
        add("of three bytes", std::vector<std::byte>(3));
        add("of zeros", std::vector<std::byte>(control.size()));
        add("of ones", std::vector<std::byte>(control.size(), std::byte{0xFF}));
        add("cut after its first offset", {control.begin(), control.begin() + 4});
        std::vector<std::byte> wild(control.begin(), control.end());
        const auto beyond = static_cast<std::uint32_t>(control.size() + 4);
        std::memcpy(wild.data(), &beyond, sizeof beyond);
        add("whose root lies outside", std::move(wild));
    }
}

// ---- blocks that are not what they say

void add_bad_blocks(Table& table) {
    const auto add = [&](const char* name, const std::function<void(wire::BlockT&)>& spoil) {
        wire::QueryRaysT rays;
        rays.blocks.push_back(std::make_unique<wire::BlockT>());
        wire::BlockT& block = *rays.blocks[0];
        block.name = "rays";
        block.dtype = wire::Dtype::f32;
        block.count = 2;
        block.stride = 32;
        block.bytes = 64;
        spoil(block);
        Frame frame = protocol::encode(query_id, rays).value();
        frame.header.block_count = 1;
        frame.header.bulk_bytes = 64;
        frame.bulk = Buffer(64);
        std::memset(frame.bulk.data(), 0, 64);
        table.kept(name, frame, Code::bad_frame);
    };
    add("a block without a name", [](auto& b) { b.name = ""; });
    add("a block of an overlong name", [](auto& b) { b.name = std::string(257, 'n'); });
    add("a block of an unknown dtype", [](auto& b) { b.dtype = static_cast<wire::Dtype>(200); });
    add("a block of stride 0", [](auto& b) { b.stride = 0; });
    add("a block of stride 5", [](auto& b) { b.stride = 5; });
    add("a block of stride 2^32 - 1", [](auto& b) { b.stride = ~0U; });
    add("a block whose stride is no multiple of its dtype", [](auto& b) { b.stride = 2; });
    add("a block with one element too many", [](auto& b) { b.count = 3; });
    add("a block with one element too few", [](auto& b) { b.count = 1; });
    add("a block whose product wraps to its bytes", [](auto& b) { b.count = (1ULL << 59) + 2; });
    add("a block longer than the bulk part", [](auto& b) { b.bytes = 128, b.count = 4; });
    add("a block of 2^63 bytes", [](auto& b) { b.bytes = 1ULL << 63, b.count = 1ULL << 58; });
    add("a block of 2^64 - 32 bytes", [](auto& b) { b.bytes = ~0ULL - 31, b.count = 1ULL << 59; });
    add("a block that leaves bytes behind", [](auto& b) { b.bytes = 0, b.count = 0; });
    add("a block off its place", [](auto& b) { b.offset = 64; });
    add("a block at an odd offset", [](auto& b) { b.offset = 1; });
    add("a block at 2^64 - 64", [](auto& b) { b.offset = ~0ULL - 63; });

    Frame uncounted = protocol::encode(query_id, wire::QueryRaysT{}).value();
    uncounted.header.block_count = 1;
    table.kept("a header that counts a block too many", uncounted, Code::bad_frame);
    flatbuffers::FlatBufferBuilder builder;
    const auto one = wire::CreateBlock(builder, builder.CreateString("rays"));
    builder.Finish(wire::CreateQueryRays(builder, 0, builder.CreateVector(std::vector(8000, one))));
    const auto* data = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
    Frame many = with_control(Frame{}, {data, data + builder.GetSize()});
    many.header.type = static_cast<std::uint16_t>(wire::Message::QueryRays);
    many.header.request_id = query_id;
    table.kept("a list of 8000 blocks that are one table", many, Code::bad_frame);

    protocol::Bulk twice;
    twice.add("rays", wire::Dtype::f32, 8, 1);
    twice.add("rays", wire::Dtype::f32, 8, 1);
    twice.allocate();
    std::memset(twice.block(0).data(), 0, 32);
    std::memset(twice.block(1).data(), 0, 32);
    table.kept("a block twice",
               protocol::encode(query_id, wire::QueryRaysT{}, std::move(twice)).value(),
               Code::bad_frame);
}

}  // namespace

std::vector<std::byte> table_bomb() {
    flatbuffers::FlatBufferBuilder builder;
    const auto param = wire::CreateParam(builder, builder.CreateString("p"));
    const auto params = builder.CreateVector(std::vector(64, param));
    const auto variant =
        wire::CreateVariant(builder, builder.CreateString("v"), 0, 0, 0, 0, params);
    const auto variants = builder.CreateVector(std::vector(8000, variant));
    builder.Finish(wire::CreateVariantList(builder, 0, 1, variants));
    std::vector<std::byte> bytes(builder.GetSize());
    std::memcpy(bytes.data(), builder.GetBufferPointer(), bytes.size());
    return bytes;
}

std::vector<Malformed> malformed_frames() {
    Table table;
    add_foreign_bytes(table);
    add_bad_headers(table);
    add_unknown_types(table);
    add_bad_controls(table);
    add_malformed_messages(table);
    add_bad_blocks(table);
    return table.take();
}

}  // namespace raynest::golden
