// The bytes of a scene's buffers and pictures, fetched before tinygltf runs.
//
// tinygltf refuses files that glTF allows or that only stumble over something unused: a buffer
// without data, a data URI without base64, an accessor of an unknown type. So it is given a text
// without bytes in which nothing else of that kind is left; the bytes come from here.
#pragma once

#include "engine/assets/gltf_names.h"
#include "engine/result.h"

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::gltf {

/// Bytes of a buffer or a picture, or the reason why there are none: "has no data".
struct Fetched {
    std::vector<unsigned char> bytes;
    std::string fault = {};
};

struct FetchedImage {
    std::string name;
    std::int64_t view = -1;  ///< a bufferView of the file; `fetched` is empty then
    Fetched fetched;
};

struct Rewritten {
    std::string json;  ///< without buffers, images and animations
    std::vector<Fetched> buffers;
    std::vector<FetchedImage> images;
    /// Accessors whose type or componentType glTF does not know; the text states some other.
    std::vector<std::size_t> untyped;
    /// Accessors without a bufferView that hold indices: in the text they name an empty bufferView
    /// behind those of the file.
    std::vector<std::size_t> unplaced;
};

/// `json` has passed prescan_json; `binary` is the BIN chunk. Errors are for memory or a file that
/// names others again and again: what is missing or damaged is a fault of its buffer or picture.
Result<Rewritten> rewrite(std::span<const std::byte> json, std::span<const std::byte> binary,
                          Upload& upload);

/// The content of a data URI, base64 or percent-encoded; nothing where it is damaged.
[[nodiscard]] std::optional<std::vector<unsigned char>> decode_data_uri(std::string_view uri);

}  // namespace raynest::gltf
