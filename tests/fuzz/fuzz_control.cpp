// Opens one control message: the first byte is its type, the rest the FlatBuffers table. This
// reaches deeper into the verifier and validate() than whole frames, whose headers mostly fail
// first. Every field of an accepted message is read, and writing it again gives the same content.
#include "tests/fuzz/target.h"
#include "tests/golden/examples.h"
#include "tests/golden/full.h"

#include <algorithm>
#include <cstring>

using namespace raynest;

namespace {

fuzz::Input input_of(const protocol::Frame& frame) {
    fuzz::Input input = {static_cast<std::uint8_t>(frame.header.type)};
    for (const std::byte byte : frame.control.span())
        input.push_back(static_cast<std::uint8_t>(byte));
    return input;
}

void check_accepted(const protocol::Frame& frame) {
    const auto once = golden::rewrite(frame);
    if (!once) return;
    const auto twice = golden::rewrite(*once);
    fuzz::require(twice && std::ranges::equal(once->control.span(), twice->control.span()));
}

}  // namespace

std::vector<fuzz::Input> fuzz::seeds() {
    std::vector<Input> seeds;
    for (const golden::Example& example : golden::examples())
        seeds.push_back(input_of(example.frame));
    for (const wire::Message type : golden::message_types())
        seeds.push_back(input_of(golden::full_message(type).frame));
    return seeds;
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size == 0) return 0;
    protocol::Frame frame;
    frame.header.type = data[0];
    frame.control = protocol::Buffer(size - 1);
    if (size > 1) std::memcpy(frame.control.data(), data + 1, size - 1);
    frame.header.control_bytes = static_cast<std::uint32_t>(size - 1);
    // Test with and without a bulk part, because a block list may ask for either.
    if (golden::open_any(frame)) check_accepted(frame);
    frame.header.block_count = 1;
    frame.header.bulk_bytes = 64;
    frame.bulk = protocol::Buffer(64);
    std::memset(frame.bulk.data(), 0, 64);
    if (golden::open_any(frame)) check_accepted(frame);
    return 0;
}
