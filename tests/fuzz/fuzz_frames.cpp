// Runs the frame decoder and every message behind it over a stream in pieces of changing size.
// Writing an accepted frame must give the same bytes again.
#include "protocol/frame.h"
#include "tests/fuzz/target.h"
#include "tests/golden/examples.h"

#include <algorithm>
#include <cstring>

using namespace raynest;

std::vector<fuzz::Input> fuzz::seeds() {
    std::vector<Input> seeds;
    Input all;
    for (const golden::Example& example : golden::examples()) {
        const std::vector<std::byte> bytes = golden::wire_bytes(example.frame);
        const auto* data = reinterpret_cast<const std::uint8_t*>(bytes.data());
        seeds.emplace_back(data, data + bytes.size());
        all.insert(all.end(), data, data + bytes.size());
    }
    seeds.push_back(std::move(all));
    return seeds;
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const std::span bytes(reinterpret_cast<const std::byte*>(data), size);
    // Use small limits, so that a large random length does not spend the run on allocating.
    protocol::Limits limits;
    limits.frame_bytes_max = 1 << 20;
    protocol::FrameDecoder decoder(limits);
    std::size_t frame_begin = 0;
    std::size_t piece = 1;
    for (std::size_t at = 0; at < size;) {
        const std::size_t count = std::min(piece, size - at);
        piece = piece * 3 % 61 + 1;
        if (!decoder.room().empty() && piece % 2 == 0) {
            const std::size_t direct = std::min(count, decoder.room().size());
            std::memcpy(decoder.room().data(), data + at, direct);
            decoder.filled(direct);
            at += direct;
        } else {
            const auto taken = decoder.feed(bytes.subspan(at, count));
            if (!taken) return 0;
            at += *taken;
        }
        if (!decoder.complete()) continue;
        const protocol::Frame frame = decoder.take();
        const std::vector<std::byte> again = golden::wire_bytes(frame);
        fuzz::require(std::ranges::equal(again, bytes.subspan(frame_begin, again.size())));
        fuzz::require(frame_begin + again.size() == at);
        frame_begin = at;
        static_cast<void>(golden::open_any(frame));
    }
    return 0;
}
