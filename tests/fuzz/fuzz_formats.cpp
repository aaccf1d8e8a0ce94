// Reads hostile files of all formats but glTF: the first byte chooses the format.
#include "engine/assets/formats/formats.h"
#include "tests/fuzz/target.h"

#include <array>
#include <bit>
#include <cstdint>
#include <string>

using namespace raynest;

namespace {

constexpr std::array names{"x.ply", "x.stl", "x.obj", "x.off", "x.npz", "x.las", "x.mtl", "x.tif"};

fuzz::Input seed(std::size_t format, const std::string& text) {
    const std::string whole = std::string(1, static_cast<char>(format)) + text;
    return {whole.begin(), whole.end()};
}

/// A GeoTIFF of 2 x 2 heights in one strip.
std::string tiff() {
    std::string file("II*\0\x08\0\0\0", 8);
    const auto add = [&file](std::uint64_t value, int bytes) {
        for (int i = 0; i < bytes; ++i) file.push_back(static_cast<char>(value >> (8 * i)));
    };
    constexpr std::uint32_t shorts = 3, longs = 4, doubles = 12, tags = 12;
    constexpr std::uint32_t behind = 8 + 2 + 12 * tags + 4;
    add(tags, 2);
    const auto tag = [&](std::uint32_t number, std::uint32_t type, std::uint32_t count,
                         std::uint32_t value) {
        add(number, 2), add(type, 2), add(count, 4), add(value, 4);
    };
    tag(256, shorts, 1, 2), tag(257, shorts, 1, 2);                              // columns, rows
    tag(258, shorts, 1, 16), tag(259, shorts, 1, 1), tag(262, shorts, 1, 1);     // bits, not packed
    tag(273, longs, 1, behind), tag(277, shorts, 1, 1), tag(278, shorts, 1, 2);  // one strip
    tag(279, longs, 1, 8), tag(339, shorts, 1, 2);                               // signed
    tag(33550, doubles, 3, behind + 8), tag(33922, doubles, 6, behind + 32);     // georeference
    add(0, 4);
    for (std::uint32_t height = 1; height <= 4; ++height) add(height, 2);
    for (const double number : {1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 500000.0, 5000000.0, 0.0})
        add(std::bit_cast<std::uint64_t>(number), 8);
    return file;
}

}  // namespace

std::vector<fuzz::Input> fuzz::seeds() {
    const std::string header =
        " 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "property uchar red\nelement face 1\nproperty list uchar int vertex_indices\n"
        "end_header\n";
    std::string las = "LASF" + std::string(371, '\0') + std::string(60, '\1');
    las[24] = 1, las[25] = 2, las[94] = '\xE3', las[96] = '\xE3', las[105] = 20, las[107] = 3;
    std::string coloured = las + std::string(30, '\2');
    coloured[104] = 2, coloured[105] = 26;
    std::string binary(84 + 100, '\0');
    binary[80] = 2;
    const std::string npz("PK\1\2", 4);
    return {seed(0, "ply\nformat ascii" + header + "0 0 0 1\n1 0 0 2\n0 1 0 3\n3 0 1 2\n"),
            seed(0, "ply\nformat binary_little_endian" + header + std::string(39, '\0') + '\3' +
                        std::string(12, '\0')),
            seed(1,
                 "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 "
                 "0\nendloop\n"
                 "endfacet\nendsolid a\n"),
            seed(1, binary),
            seed(2,
                 "mtllib x.mtl\no a\nv 0 0 0\nv 1 0 0\nv 1 1 0 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 "
                 "1\nusemtl a\n"
                 "f 1/1/1 2/1/1 3/1/1 4/1/1\nf -1 -2 -3\n"),
            seed(3, "COFF\n4 1 0\n0 0 0 255 0 0 255\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"),
            seed(4, npz + std::string(60, '\0') + "PK\5\6" + std::string(18, '\0')),
            seed(5, las),
            seed(5, coloured),
            seed(7, tiff()),
            seed(6, "newmtl a\nKd 1 0.5 0\nd 0.5\nmap_Kd -s 1 1 1 a.png\nKe 1\n")};
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size < 2) return 0;
    const std::string name = names[data[0] % names.size()];
    const auto bytes = std::as_bytes(std::span(data, size).subspan(1));
    ImportRequest request;
    request.source = name;
    if (name == "x.mtl") {
        constexpr std::string_view obj = "mtllib x.mtl\nv 0 0 0\nusemtl a\nf 1 1 1\n";
        request.source = "x.obj";
        request.files.push_back({"x.obj", std::as_bytes(std::span(obj))});
    }
    request.files.push_back({name, bytes});
    request.options.radius = 1;
    request.options.auto_origin = true;
    ImportLimits limits;
    limits.file_bytes_max = 1 << 20;
    auto content = find_format(request.source)->read(request, limits);
    if (content) {
        const auto scene = place(std::move(*content), request, limits);
        if (!scene) fuzz::require(!scene.error().message.empty());
    } else {
        fuzz::require(!content.error().message.empty() &&
                      content.error().message.find('\n') == std::string::npos);
    }
    return 0;
}
