// Limits the cost of decoding a file's meshes; counted down before anything is allocated.
#pragma once

#include "engine/assets/gltf/file/model.h"

#include <fmt/format.h>

namespace raynest::gltf {

/// Decoded geometry is at most 12 times its encoded form (a strip of byte indices) plus slack. A
/// file that exceeds this is small and names the same bytes repeatedly to use up memory.
inline constexpr std::uint64_t decoded_bytes_free = 32ULL << 20;
inline constexpr std::uint64_t decoded_bytes_per_byte = 32;

/// A posed mesh (skins.h) is decoded once in addition to the mesh in the file.
inline constexpr std::uint64_t posed_bytes_free = 1ULL << 20;

/// The triangles and bytes that may still be decoded.
struct Budget {
    std::uint64_t triangles;
    std::uint64_t bytes;

    Budget(const Model& model, const ImportLimits& limits)
        : triangles(limits.triangles_max),
          bytes(decoded_bytes_free +
                (model.upload_bytes + model.decompressed_bytes) * decoded_bytes_per_byte) {
        for (const Mesh& mesh : model.meshes) {
            if (mesh.pose_of != no_id) bytes += posed_bytes_free;
        }
    }

    Result<void> take_bytes(std::uint64_t count) {
        if (count > bytes) {
            return fail(ErrorCode::limit_exceeded,
                        fmt::format("the scene's meshes decode to more than {} times its files; "
                                    "it names the same data repeatedly",
                                    decoded_bytes_per_byte));
        }
        bytes -= count;
        return {};
    }
    Result<void> take_triangles(std::uint64_t count, std::uint64_t limit) {
        if (count > triangles) {
            return fail(ErrorCode::limit_exceeded,
                        fmt::format("the scene has more than {} triangles", limit));
        }
        triangles -= count;
        return {};
    }
};

}  // namespace raynest::gltf
