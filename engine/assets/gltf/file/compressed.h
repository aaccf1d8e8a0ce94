// Decompresses a file's geometry in place, before any other code reads it.
#pragma once

#include "engine/assets/gltf/file/convert.h"

namespace raynest::gltf {

/// A decoder for an extension; its library may be missing in this build.
struct Decoder {
    const char* extension;
    Result<void> (*available)();  ///< an error with the remedy if the library is missing
};
/// Returns the decoder of an extension, or null.
[[nodiscard]] const Decoder* find_decoder(std::string_view extension);

/// True if the bufferView has EXT_meshopt_compression that this build decodes. Without the library
/// the view may have a fallback.
[[nodiscard]] bool is_compressed(const tinygltf::BufferView& view);
/// Decodes a bufferView; model.storage holds the file's buffers. Pass errors to blame().
Result<View> decompress(const tinygltf::BufferView& view, Model& model);

/// Replaces the accessors held by a primitive's KHR_draco_mesh_compression with decoded ones. These
/// are always added, because primitives may use the same stream in different ways. Does nothing if
/// the primitive is not compressed. Pass errors to blame().
Result<void> decompress(const tinygltf::Primitive& from, Model& model, Primitive& to);

}  // namespace raynest::gltf
