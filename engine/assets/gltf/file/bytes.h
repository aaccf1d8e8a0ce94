// The bytes of a scene's buffers and pictures, fetched before tinygltf runs.
//
// tinygltf refuses files that glTF allows, or in which only an unused part is wrong: a buffer
// without data, a data URI without base64, an accessor of an unknown type. So it reads a text
// without bytes, from which all such parts are removed; the bytes come from here.
#pragma once

#include "engine/assets/input/uploaded_files.h"
#include "engine/result.h"

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::gltf {

/// Bytes of a buffer or a picture, or the reason for their absence: "has no data".
struct Fetched {
    std::vector<unsigned char> bytes;
    std::string fault = {};
};

struct FetchedImage {
    std::string name;
    std::int64_t view = -1;  ///< the picture's bufferView, if any; `fetched` is empty then
    Fetched fetched;
};

/// The yfov that cameras of an unknown type get in a rewritten text, which knows two types.
inline constexpr double yfov_of_unknown_type = -1e30;

/// The innerConeAngle that a spot light without `spot` gets in a rewritten text.
inline constexpr double cone_of_no_spot = -1e30;

struct Rewritten {
    std::string json;  ///< the scene without buffers and images
    std::vector<Fetched> buffers;
    std::vector<FetchedImage> images;
    /// Accessors whose type or componentType is unknown; the text states a valid one instead.
    std::vector<std::size_t> untyped;
    /// Accessors without a bufferView that hold indices. In the text they name an empty bufferView,
    /// placed after those of the file.
    std::vector<std::size_t> unplaced;
    /// byteStrides that tinygltf refuses, by their bufferView; the text states none.
    std::map<std::size_t, std::uint64_t> strides;
    /// Materials whose baseColorFactor is not of four; the text states none.
    std::vector<std::size_t> colourless;
};

/// Rewrites `json`, which has passed prescan_json; `binary` is the BIN chunk. Returns an error only
/// for lack of memory, or if the file names other files repeatedly. Missing or damaged data is
/// stored as the fault of its buffer or picture.
Result<Rewritten> rewrite(std::span<const std::byte> json, std::span<const std::byte> binary,
                          Upload& upload);

/// Returns a text of rewrite() without its animations.
std::string without_animations(const std::string& json);

/// Returns the content of a data URI, base64 or percent-encoded; nothing if it is damaged.
[[nodiscard]] std::optional<std::vector<unsigned char>> decode_data_uri(std::string_view uri);

}  // namespace raynest::gltf
