// Compressed geometry of a file: put in the place of what tinygltf read, before anything uses it.
#pragma once

#include "engine/assets/gltf_convert.h"

namespace raynest::gltf {

/// An extension that takes a library to read, which a build may lack.
struct Decoder {
    const char* extension;
    Result<void> (*available)();  ///< else an error with the remedy
};
/// The decoder of an extension, or null.
[[nodiscard]] const Decoder* find_decoder(std::string_view extension);

/// Whether this build decodes a bufferView's EXT_meshopt_compression. Where it does not, the file
/// may have given the bufferView a fallback.
[[nodiscard]] bool is_compressed(const tinygltf::BufferView& view);
/// Decodes it; model.storage holds the file's buffers. Errors are for blame().
Result<View> decompress(const tinygltf::BufferView& view, Model& model);

/// Replaces what a primitive's KHR_draco_mesh_compression holds by decoded accessors, which are new
/// ones: primitives may name the same stream in different ways. Does nothing where a primitive is
/// not compressed. Errors are for blame().
Result<void> decompress(const tinygltf::Primitive& from, Model& model, Primitive& to);

}  // namespace raynest::gltf
