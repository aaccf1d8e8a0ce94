#include "protocol/blocks.h"

#include "protocol/control.h"

#include <doctest/doctest.h>

#include <cstdint>

using namespace raynest;
using protocol::Bulk;

namespace {

protocol::Frame chunk_of(Bulk bulk) {
    wire::ChunkT chunk;
    chunk.count = 3;
    return protocol::encode(1, std::move(chunk), std::move(bulk)).value();
}

}  // namespace

TEST_CASE("columns come back as they were written, empty ones too") {
    Bulk bulk;
    const std::size_t uv = bulk.add("uv", wire::Dtype::f32, 2, 3);
    const std::size_t none = bulk.add("none", wire::Dtype::u64, 1, 0);
    const std::size_t hit = bulk.add("hit", wire::Dtype::u8, 1, 65);
    bulk.allocate();
    CHECK(bulk.bytes() == 64 + 0 + 128);
    for (std::size_t i = 0; i < 6; ++i) bulk.block_as<float>(uv)[i] = static_cast<float>(i);
    CHECK(bulk.block(none).empty());
    for (std::size_t i = 0; i < 65; ++i) bulk.block_as<std::uint8_t>(hit)[i] = 7;

    const protocol::Frame frame = chunk_of(std::move(bulk));
    const auto opened = protocol::open<wire::Chunk>(frame);
    REQUIRE(opened);
    REQUIRE(opened->blocks.size() == 3);
    const protocol::BlockView* found = protocol::find_block(opened->blocks, "uv");
    REQUIRE(found != nullptr);
    CHECK(found->width() == 2);
    CHECK(found->count == 3);
    CHECK(found->values<float>()[5] == 5.0F);
    CHECK(protocol::find_block(opened->blocks, "none")->count == 0);
    CHECK(protocol::find_block(opened->blocks, "hit")->values<std::uint8_t>()[64] == 7);
    CHECK(protocol::find_block(opened->blocks, "nowhere") == nullptr);
    // Padding is zero, so that equal answers are equal bytes.
    for (std::size_t i = 64 + 65; i < frame.bulk.size(); ++i)
        CHECK(frame.bulk.data()[i] == std::byte{0});
}

TEST_CASE("names of columns stand in tables and JSON as they are") {
    for (const char* name :
         {"", "a b", "a\x1b[31m", "a\"b", "a\\b", "a\x7f", "\xc2\x9b", "\xc3\xa4"}) {
        Bulk bulk;
        bulk.add(name, wire::Dtype::u8, 1, 1);
        bulk.allocate();
        const protocol::Frame frame = chunk_of(std::move(bulk));
        const auto opened = protocol::open<wire::Chunk>(frame);
        REQUIRE_MESSAGE(!opened, name);
        CHECK(opened.error().code == protocol::Code::bad_frame);
    }
}

TEST_CASE("a message with the wrong block reports the expected one") {
    const auto only = [](std::string_view name, wire::Dtype dtype, std::uint32_t width) {
        Bulk bulk;
        bulk.add(name, dtype, width, 1);
        bulk.allocate();
        const protocol::Frame frame = chunk_of(std::move(bulk));
        const auto opened = protocol::open<wire::Chunk>(frame);
        return protocol::only_block(opened.value().blocks, "rays", wire::Dtype::f32, {32, 24})
            .has_value();
    };
    CHECK(only("rays", wire::Dtype::f32, 8));
    CHECK(only("rays", wire::Dtype::f32, 6));
    CHECK(!only("ray", wire::Dtype::f32, 8));
    CHECK(!only("rays", wire::Dtype::u32, 8));
    CHECK(!only("rays", wire::Dtype::f32, 4));

    Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, 8, 1);
    bulk.add("more", wire::Dtype::f32, 8, 1);
    bulk.allocate();
    const protocol::Frame frame = chunk_of(std::move(bulk));
    const auto opened = protocol::open<wire::Chunk>(frame);
    CHECK(!protocol::only_block(opened.value().blocks, "rays", wire::Dtype::f32, {32, 24}));
}

TEST_CASE("a message that carries no blocks does not open with a bulk part") {
    protocol::Frame frame = protocol::encode(1, wire::PingT{}).value();
    frame.header.block_count = 1;
    frame.header.bulk_bytes = 64;
    frame.bulk = protocol::Buffer(64);
    const auto opened = protocol::open<wire::Ping>(frame);
    REQUIRE(!opened);
    CHECK(opened.error().code == protocol::Code::bad_frame);
}
