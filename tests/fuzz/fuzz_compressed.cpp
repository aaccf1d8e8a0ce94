// Decodes hostile compressed geometry: the first bytes state its form, the rest is the stream. It
// must decode to at most the allowed size, or fail.
#include "engine/assets/gltf/file/draco.h"
#include "engine/assets/gltf/file/meshopt.h"
#include "tests/fuzz/target.h"
#include "tests/unit/engine/assets/draco_streams.h"

#include <meshoptimizer.h>

#include <array>
#include <span>

using namespace raynest;

namespace {

constexpr std::uint64_t bytes_max = 1 << 20;
constexpr std::array<const char*, 4> modes{"ATTRIBUTES", "TRIANGLES", "INDICES", "OTHER"};
constexpr std::array<const char*, 4> filters{"NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL"};

/// Byte 0 chooses Draco (even) or meshopt; three more state count, stride, and mode with filter, or
/// type, width and id.
constexpr std::size_t head = 4;

fuzz::Input input(std::array<std::uint8_t, head> first, const unsigned char* data,
                  std::size_t size) {
    fuzz::Input out;
    out.reserve(head + size);
    for (const std::uint8_t byte : first) out.push_back(byte);
    for (const unsigned char byte : std::span(data, size)) out.push_back(byte);
    return out;
}

}  // namespace

std::vector<fuzz::Input> fuzz::seeds() {
    std::vector<Input> seeds;
    for (const std::span<const std::uint8_t> stream :
         {std::span<const std::uint8_t>(test::draco_sequential),
          std::span<const std::uint8_t>(test::draco_edgebreaker),
          std::span<const std::uint8_t>(test::draco_skinned)}) {
        seeds.push_back(input({0, 5, 3, 0}, stream.data(), stream.size()));
    }
    std::array<unsigned char, 1024> out{};
    const std::array<float, 12> quad{0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0};
    const std::array<unsigned, 6> triangles{0, 1, 2, 2, 1, 3};
    std::size_t size = meshopt_encodeVertexBuffer(out.data(), out.size(), quad.data(), 6, 8);
    for (std::uint8_t filter = 0; filter < 4; ++filter)
        seeds.push_back(input({1, 6, 8, static_cast<std::uint8_t>(filter << 2)}, out.data(), size));
    size = meshopt_encodeIndexBuffer(out.data(), out.size(), triangles.data(), 6);
    seeds.push_back(input({1, 6, 4, 1}, out.data(), size));
    size = meshopt_encodeIndexSequence(out.data(), out.size(), triangles.data(), 6);
    seeds.push_back(input({1, 6, 2, 2}, out.data(), size));
    return seeds;
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size < head) return 0;
    const auto stream = std::as_bytes(std::span(data, size)).subspan(head);
    if (data[0] % 2 == 0) {
        const gltf::DracoAttribute wanted{data[3], static_cast<gltf::Component>(data[1] % 6),
                                          data[2] % 17U};
        const auto mesh = gltf::decode_draco(stream, std::span(&wanted, 1), bytes_max);
        if (mesh) fuzz::require(mesh->indices.size() + mesh->attributes[0].size() <= bytes_max);
        return 0;
    }
    const gltf::MeshoptView view{stream, data[1], data[2], modes[data[3] % 4],
                                 filters[data[3] / 4 % 4]};
    const auto bytes = gltf::meshopt_bytes(view);
    if (!bytes) return 0;
    const auto decoded = gltf::decode_meshopt(view);
    if (decoded) fuzz::require(decoded->size() == *bytes);
    return 0;
}
