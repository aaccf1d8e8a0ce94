// One control message: the first byte is its type, the rest the FlatBuffers table. Reaches deeper
// into the verifier and validate() than whole frames do, whose headers mostly break first.
#include "tests/fuzz/target.h"
#include "tests/golden/examples.h"

#include <cstring>

using namespace raynest;

std::vector<fuzz::Input> fuzz::seeds() {
    std::vector<Input> seeds;
    for (const golden::Example& example : golden::examples()) {
        const auto* control = reinterpret_cast<const std::uint8_t*>(example.frame.control.data());
        Input seed = {static_cast<std::uint8_t>(example.frame.header.type)};
        seed.insert(seed.end(), control, control + example.frame.control.size());
        seeds.push_back(std::move(seed));
    }
    return seeds;
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size == 0) return 0;
    protocol::Frame frame;
    frame.header.type = data[0];
    frame.control = protocol::Buffer(size - 1);
    if (size > 1) std::memcpy(frame.control.data(), data + 1, size - 1);
    frame.header.control_bytes = static_cast<std::uint32_t>(size - 1);
    // With and without a bulk part, as a block list may ask for either.
    static_cast<void>(golden::open_any(frame));
    frame.header.block_count = 1;
    frame.header.bulk_bytes = 64;
    frame.bulk = protocol::Buffer(64);
    std::memset(frame.bulk.data(), 0, 64);
    static_cast<void>(golden::open_any(frame));
    return 0;
}
