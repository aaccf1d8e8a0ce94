// The GLB container: a 12-byte header and chunks of {u32 length, u32 type, bytes}, little-endian.
#include "engine/assets/gltf/file/prescan.h"
#include "engine/assets/input/messages.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>

namespace raynest::gltf {
namespace {

constexpr std::uint32_t magic_gltf = 0x46546C67;
constexpr std::uint32_t chunk_json = 0x4E4F534A;
constexpr std::uint32_t chunk_bin = 0x004E4942;

std::uint32_t read_u32(std::span<const std::byte> file, std::size_t at) {
    std::uint32_t value = 0;
    std::memcpy(&value, file.data() + at, sizeof value);
    return value;
}

}  // namespace

bool starts_as_glb(std::span<const std::byte> file) {
    return file.size() >= 4 && read_u32(file, 0) == magic_gltf;
}

Result<Glb> open_glb(std::span<const std::byte> file) {
    if (!starts_as_glb(file)) {
        const auto* const text = reinterpret_cast<const char*>(file.data());
        return fail(ErrorCode::scene_invalid,
                    fmt::format("the file is no GLB: it begins with '{}'",
                                one_line({text, std::min<std::size_t>(file.size(), 24)})));
    }
    if (file.size() < 12)
        return fail(ErrorCode::scene_invalid, "the GLB file ends inside its header");
    if (const std::uint32_t version = read_u32(file, 4); version != 2) {
        return fail(
            ErrorCode::scene_unsupported,
            fmt::format("GLB version {} is not supported; export the scene as glTF 2.0", version));
    }
    const std::uint32_t total = read_u32(file, 8);
    if (total > file.size()) {
        return fail(ErrorCode::scene_invalid,
                    fmt::format("the GLB header declares {} bytes but the file has {}; it is cut "
                                "short or damaged",
                                total, file.size()));
    }
    file = file.first(total);  // bytes after the scene are ignored

    Glb glb;
    std::size_t at = 12;
    for (std::size_t index = 0; at < file.size(); ++index) {
        if (file.size() - at < 8) {
            return fail(ErrorCode::scene_invalid, "the GLB file ends inside a chunk header");
        }
        const std::uint64_t length = read_u32(file, at);
        const std::uint32_t type = read_u32(file, at + 4);
        at += 8;
        if (length > file.size() - at) {
            return fail(ErrorCode::scene_invalid,
                        fmt::format("GLB chunk {} declares {} bytes but only {} are left", index,
                                    length, file.size() - at));
        }
        const auto chunk = file.subspan(at, length);
        if (index == 0 && type != chunk_json) break;
        if (index == 0) glb.json = chunk;
        if (index == 1 && type == chunk_bin) glb.binary = chunk;
        at += length;
    }
    if (glb.json.empty()) {
        return fail(ErrorCode::scene_invalid, "the GLB file does not start with a JSON chunk");
    }
    return glb;
}

}  // namespace raynest::gltf
