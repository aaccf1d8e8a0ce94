// Parses a hostile .npy: an accepted one has exactly as many bytes as its shape states.
#include "client/files/npy.h"
#include "tests/fuzz/target.h"

using namespace raynest;

std::vector<fuzz::Input> fuzz::seeds() {
    std::vector<Input> seeds;
    const std::vector<std::byte> zeros(96);
    for (const client::Array& array :
         {client::Array{"<f4", {3, 8}, zeros}, client::Array{"<f8", {12}, zeros},
          client::Array{"|u1", {4, 4, 6}, zeros},
          client::Array{"<u4", {}, std::span(zeros).first(4)}}) {
        const std::vector<std::byte> file = client::format_npy(array);
        const auto* data = reinterpret_cast<const std::uint8_t*>(file.data());
        seeds.emplace_back(data, data + file.size());
    }
    return seeds;
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const auto array = client::parse_npy(std::span(reinterpret_cast<const std::byte*>(data), size));
    if (!array) return 0;
    std::uint64_t elements = 1;
    for (const std::uint64_t extent : array->shape) elements *= extent;
    fuzz::require(array->bytes.size() ==
                  elements * static_cast<std::uint64_t>(array->dtype[2] - '0'));
    return 0;
}
