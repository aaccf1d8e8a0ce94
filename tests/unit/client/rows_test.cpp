#include "client/ground/failure.h"
#include "client/ground/text.h"
#include "client/output/output.h"
#include "client/output/query_rows.h"

#include <doctest/doctest.h>

#include <cstring>
#include <iostream>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

using namespace raynest;
using client::QueryChunk;
using client::QueryRows;

namespace {

/// Two rays: a hit and a miss of a closest query.
struct Sample {
    protocol::Bulk bulk;
    std::vector<protocol::BlockView> columns;
    std::vector<std::uint64_t> splits = {0, 1, 2};

    Sample() {
        bulk.add("t", wire::Dtype::f32, 1, 2);
        bulk.add("path", wire::Dtype::u64, 1, 2);
        bulk.add("uv", wire::Dtype::f32, 2, 2);
        bulk.add("ng", wire::Dtype::f32, 3, 2);
        bulk.add("nodes", wire::Dtype::u32, 1, 2);
        bulk.add("hit", wire::Dtype::u8, 1, 2);
        bulk.allocate();
        bulk.block_as<float>(0)[0] = 4.3F;
        bulk.block_as<float>(0)[1] = std::numeric_limits<float>::infinity();
        bulk.block_as<std::uint64_t>(1)[0] = 77;
        bulk.block_as<std::uint64_t>(1)[1] = ~0ULL;
        const float uv[] = {0.25F, 0.5F, 0, 0};
        std::memcpy(bulk.block(2).data(), uv, sizeof uv);
        const float ng[] = {0, 1, 0, 0, 0, 0};
        std::memcpy(bulk.block(3).data(), ng, sizeof ng);
        bulk.block_as<std::uint32_t>(4)[0] = 12;
        bulk.block_as<std::uint32_t>(4)[1] = 3;
        bulk.block_as<std::uint8_t>(5)[0] = 1;
        bulk.block_as<std::uint8_t>(5)[1] = 0;
        for (std::size_t i = 0; i < bulk.count(); ++i) {
            const wire::BlockT& block = *bulk.descriptions()[i];
            columns.push_back({block.name, block.dtype, block.stride, block.count, bulk.block(i)});
        }
    }
    [[nodiscard]] QueryChunk chunk() const { return {5, 2, splits, columns}; }
};

template <class Rows>
std::string printed(Rows rows, const QueryChunk& chunk) {
    std::ostringstream out;
    std::streambuf* const before = std::cout.rdbuf(out.rdbuf());
    const auto done = rows.print(chunk);
    std::cout.rdbuf(before);
    CHECK(done);
    return out.str();
}

}  // namespace

TEST_CASE("JSON rows have keys that scripts rely on, and misses have no hits") {
    const Sample sample;
    CHECK(printed(QueryRows("closest", {"t", "path", "uv"}, true), sample.chunk()) ==
          "{\"ray\":5,\"hits\":[{\"t\":4.3,\"path\":77,\"u\":0.25,\"v\":0.5}]}\n"
          "{\"ray\":6,\"hits\":[]}\n");
    CHECK(printed(QueryRows("closest", {"ng", "nodes"}, true), sample.chunk()) ==
          "{\"ray\":5,\"hits\":[{\"ng\":[0,1,0]}],\"nodes\":12}\n"
          "{\"ray\":6,\"hits\":[],\"nodes\":3}\n");
    CHECK(printed(QueryRows("any", {"hit"}, true), sample.chunk()) ==
          "{\"ray\":5,\"hit\":true}\n{\"ray\":6,\"hit\":false}\n");
}

TEST_CASE("several hits of a ray are several objects") {
    const Sample sample;
    QueryChunk chunk = sample.chunk();
    const std::vector<std::uint64_t> splits = {0, 2, 2};
    chunk.splits = splits;
    const std::vector<protocol::BlockView> columns = {sample.columns[1]};
    chunk.columns = columns;
    CHECK(printed(QueryRows("multi", {"path"}, true), chunk) ==
          "{\"ray\":5,\"hits\":[{\"path\":77},{\"path\":18446744073709551615}]}\n"
          "{\"ray\":6,\"hits\":[]}\n");
}

TEST_CASE("a table has a title, a row per hit and dashes for a miss") {
    const Sample sample;
    CHECK(printed(QueryRows("closest", {"t", "nodes"}, false), sample.chunk()) ==
          "       ray               t       nodes\n"
          "         5             4.3          12\n"
          "         6               -           3\n");
}

TEST_CASE("rows of a reducer are its columns, numbered if no column identifies them") {
    const Sample sample;
    QueryChunk chunk = sample.chunk();
    const std::vector<protocol::BlockView> columns = {sample.columns[1], sample.columns[4]};
    chunk.columns = columns;
    CHECK(printed(client::ReducedRows("", true), chunk) ==
          "{\"path\":77,\"nodes\":12}\n{\"path\":18446744073709551615,\"nodes\":3}\n");
    CHECK(printed(client::ReducedRows("point", false), chunk) ==
          "     point                  path       nodes\n"
          "         5                    77          12\n"
          "         6  18446744073709551615           3\n");
}

TEST_CASE("numbers read as they were meant") {
    CHECK(client::float_text(0.1F) == "0.1");
    CHECK(client::float_text(std::numeric_limits<float>::infinity()) == "null");
    CHECK(client::grouped(1234567) == "1,234,567");
    CHECK(client::grouped(999) == "999");
    CHECK(client::bytes_text(512) == "512 B");
    CHECK(client::bytes_text(3U << 20) == "3.0 MiB");
}

TEST_CASE("errors read as one line, plain or JSON") {
    const client::Failure busy = client::failure({protocol::Code::busy, "", 250});
    CHECK(client::describe(busy, false) == "raynest: the daemon is full (try again in 250 ms)");
    const auto json = nlohmann::json::parse(client::describe(busy, true));
    CHECK(json["error"]["code"] == 12);
    CHECK(json["error"]["name"] == "BUSY");
    const client::Failure odd = client::failure(protocol::Exit::invalid, "\xff.glb: is odd");
    CHECK(nlohmann::json::parse(client::describe(odd, true))["error"]["name"] == "FILE_INVALID");
}
