#include "engine/assets/gltf/file/bytes.h"

#include "engine/assets/gltf/file/uri.h"
#include "engine/assets/input/messages.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <openssl/evp.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <utility>

namespace raynest::gltf {
namespace {

using Json = nlohmann::json;

constexpr std::uint64_t gltf_stride_max = 252;

constexpr std::array<const char*, 7> accessor_types{"SCALAR", "VEC2", "VEC3", "VEC4",
                                                    "MAT2",   "MAT3", "MAT4"};

/// Returns a member of an object as unsigned number or text; nothing if absent or of another type.
std::optional<std::uint64_t> number_of(const Json& object, const char* key) {
    const auto found = object.find(key);
    if (found == object.end() || !found->is_number_unsigned()) return std::nullopt;
    return found->get<std::uint64_t>();
}
const std::string* text_of(const Json& object, const char* key) {
    const auto found = object.find(key);
    return found == object.end() ? nullptr : found->get_ptr<const std::string*>();
}

/// Turns numbers written as 36.0 into integers, which tinygltf requires. The text nests no deeper
/// than prescan_json allows.
void write_integers(Json& value) {
    if (value.is_structured()) {
        for (Json& element : value) write_integers(element);
        return;
    }
    constexpr double exact_max = 9007199254740992;  // 2^53
    if (!value.is_number_float()) return;
    const auto number = value.get<double>();
    if (number != std::floor(number) || std::abs(number) > exact_max) return;
    if (number >= 0)
        value = static_cast<std::uint64_t>(number);
    else
        value = static_cast<std::int64_t>(number);
}

/// Returns the objects of a top-level array; null if it is absent or holds something else.
Json* objects_of(Json& root, const char* key) {
    const auto found = root.find(key);
    if (found == root.end() || !found->is_array()) return nullptr;
    const bool all = std::all_of(found->begin(), found->end(),
                                 [](const Json& element) { return element.is_object(); });
    return all ? &*found : nullptr;
}

std::vector<unsigned char> copy_of(std::span<const std::byte> bytes) {
    const auto* const first = reinterpret_cast<const unsigned char*>(bytes.data());
    return {first, first + bytes.size()};
}

Result<Fetched> fetch(const std::string& uri, Upload& upload) {
    if (uri.starts_with("data:")) {
        auto bytes = decode_data_uri(uri);
        if (!bytes) return Fetched{{}, "has a data URI that cannot be decoded"};
        return Fetched{std::move(*bytes)};
    }
    const auto name = file_of_uri(uri);
    if (!name) {
        return Fetched{{},
                       fmt::format("names '{}', which {}", one_line(uri, 80), why_no_file(uri))};
    }
    const auto bytes = upload.read(*name);
    if (!bytes) return tl::unexpected<Error>(bytes.error());
    if (bytes->data() == nullptr) {
        return Fetched{{}, fmt::format("names the file '{}', which is missing", one_line(*name))};
    }
    return Fetched{copy_of(*bytes)};
}

Result<Fetched> fetch_buffer(const Json& buffer, bool is_first, std::span<const std::byte> binary,
                             Upload& upload) {
    const auto length = number_of(buffer, "byteLength");
    if (!length) return Fetched{{}, "has no byteLength"};
    Result<Fetched> data = Fetched{{}, "has no data: it names no file"};
    if (const std::string* const uri = text_of(buffer, "uri"))
        data = fetch(*uri, upload);
    else if (is_first && binary.data() != nullptr)
        data = Fetched{copy_of(binary)};
    if (!data || !data->fault.empty()) return data;
    if (data->bytes.size() < *length) {
        return Fetched{{},
                       fmt::format("has {} bytes but its byteLength is {}; it is cut short",
                                   data->bytes.size(), *length)};
    }
    data->bytes.resize(*length);
    return data;
}

Result<void> take_buffers(Json& root, std::span<const std::byte> binary, Upload& upload,
                          Rewritten& out) {
    Json* const buffers = objects_of(root, "buffers");
    if (buffers == nullptr) return {};
    for (const Json& buffer : *buffers) {
        auto data = fetch_buffer(buffer, out.buffers.empty(), binary, upload);
        if (!data) return tl::unexpected<Error>(data.error());
        out.buffers.push_back(std::move(*data));
    }
    *buffers = Json::array();
    return {};
}

Result<void> take_images(Json& root, Upload& upload, Rewritten& out) {
    Json* const images = objects_of(root, "images");
    if (images == nullptr) return {};
    for (const Json& image : *images) {
        FetchedImage taken;
        const std::string* const uri = text_of(image, "uri");
        if (const std::string* const name = text_of(image, "name")) taken.name = *name;
        if (taken.name.empty() && uri != nullptr && !uri->starts_with("data:")) taken.name = *uri;
        if (const auto view = number_of(image, "bufferView")) {
            taken.view = static_cast<std::int64_t>(std::min<std::uint64_t>(*view, 0x7FFFFFFFU));
        } else if (uri != nullptr) {
            auto data = fetch(*uri, upload);
            if (!data) return tl::unexpected<Error>(data.error());
            taken.fetched = std::move(*data);
        } else {
            taken.fetched.fault = "has no data: it names no file and no bufferView";
        }
        out.images.push_back(std::move(taken));
    }
    *images = Json::array();
    return {};
}

void state_types(Json& accessors, Rewritten& out) {
    for (std::size_t i = 0; i < accessors.size(); ++i) {
        Json& accessor = accessors[i];
        const std::string* const type = text_of(accessor, "type");
        const auto component = number_of(accessor, "componentType");
        const bool known =
            type != nullptr && component && number_of(accessor, "count") && *component >= 5120 &&
            *component <= 5126 &&
            std::find(accessor_types.begin(), accessor_types.end(), *type) != accessor_types.end();
        if (known) continue;
        accessor["type"] = "SCALAR";
        accessor["componentType"] = 5121;
        accessor["count"] = 1;
        accessor.erase("sparse");
        out.untyped.push_back(i);
    }
}

/// Gives accessors of indices a bufferView: tinygltf requires one and uses only its number.
void place_indices(Json& root, Json& accessors, Rewritten& out) {
    Json* const meshes = objects_of(root, "meshes");
    if (meshes == nullptr) return;
    for (const Json& mesh : *meshes) {
        const auto primitives = mesh.find("primitives");
        if (primitives == mesh.end() || !primitives->is_array()) continue;
        for (const Json& primitive : *primitives) {
            if (!primitive.is_object()) continue;
            const auto index = number_of(primitive, "indices");
            if (index && *index < accessors.size() && !accessors[*index].contains("bufferView"))
                out.unplaced.push_back(*index);
        }
    }
    if (out.unplaced.empty()) return;
    Json& views = root["bufferViews"];
    if (!views.is_array()) views = Json::array();
    for (const std::size_t index : out.unplaced) accessors[index]["bufferView"] = views.size();
    views.push_back({{"buffer", 0}, {"byteLength", 1}});
}

/// Takes out strides that glTF forbids, but that can be read.
void take_odd_strides(Json& views, Rewritten& out) {
    for (std::size_t i = 0; i < views.size(); ++i) {
        const auto stride = number_of(views[i], "byteStride");
        if (!stride || (*stride % 4 == 0 && *stride <= gltf_stride_max)) continue;
        views[i].erase("byteStride");
        out.strides[i] = *stride;
    }
}

/// Adds the members that tinygltf requires to a camera that lacks them, with values that are
/// rejected later. The camera keeps its index.
void complete_cameras(Json& cameras) {
    for (Json& camera : cameras) {
        const std::string* const type = text_of(camera, "type");
        const bool orthographic = type != nullptr && *type == "orthographic";
        const char* const kind = orthographic ? "orthographic" : "perspective";
        const bool is_known = type != nullptr && *type == kind;
        camera["type"] = kind;
        Json& numbers = camera[kind];
        if (!numbers.is_object()) numbers = Json::object();
        for (const char* const key : {"yfov", "xmag", "ymag", "znear", "zfar"}) {
            Json& number = numbers[key];
            if (!number.is_number()) number = 0;
        }
        if (!is_known) numbers["yfov"] = yfov_of_unknown_type;
    }
}

/// The same for a light without a type, or a spot light without its cone.
void complete_lights(Json& root) {
    const auto extensions = root.find("extensions");
    if (extensions == root.end() || !extensions->is_object()) return;
    const auto punctual = extensions->find("KHR_lights_punctual");
    if (punctual == extensions->end() || !punctual->is_object()) return;
    Json* const lights = objects_of(*punctual, "lights");
    if (lights == nullptr) return;
    for (Json& light : *lights) {
        const std::string* const type = text_of(light, "type");
        const bool is_spot = type != nullptr && *type == "spot";
        if (type == nullptr) light["type"] = "";
        if (is_spot && !light["spot"].is_object())
            light["spot"] = {{"innerConeAngle", cone_of_no_spot}};
    }
}

/// Drops each baseColorFactor that tinygltf would refuse the file for.
void drop_short_colours(Json& materials, Rewritten& out) {
    for (std::size_t i = 0; i < materials.size(); ++i) {
        const auto pbr = materials[i].find("pbrMetallicRoughness");
        if (pbr == materials[i].end() || !pbr->is_object()) continue;
        const auto colour = pbr->find("baseColorFactor");
        if (colour == pbr->end() || !colour->is_array() || colour->size() == 4) continue;
        pbr->erase(colour);
        out.colourless.push_back(i);
    }
}

/// Decodes base64 of either alphabet, padded or not.
std::optional<std::vector<unsigned char>> decode_base64(std::string_view text) {
    while (!text.empty() && text.back() == '=') text.remove_suffix(1);
    // OpenSSL takes padding within a text for a letter.
    if (text.size() % 4 == 1 || text.find('=') != std::string_view::npos) return std::nullopt;
    std::vector<unsigned char> bytes(text.size() / 4 * 3 + 3);
    constexpr std::size_t letters_at_once = 4096;
    for (std::size_t at = 0; at < text.size(); at += letters_at_once) {
        std::string part(text.substr(at, letters_at_once));
        std::ranges::replace(part, '-', '+');
        std::ranges::replace(part, '_', '/');
        part.resize((part.size() + 3) / 4 * 4, '=');
        const int length = static_cast<int>(part.size());
        const auto* const letters = reinterpret_cast<const unsigned char*>(part.data());
        // It passes over blanks at both ends, and then makes fewer bytes.
        if (EVP_DecodeBlock(bytes.data() + at / 4 * 3, letters, length) != length / 4 * 3)
            return std::nullopt;
    }
    bytes.resize(text.size() * 3 / 4);
    return bytes;
}

std::optional<std::vector<unsigned char>> decode_percent(std::string_view text) {
    std::vector<unsigned char> bytes;
    bytes.reserve(text.size());
    for (std::size_t i = 0; i < text.size(); ++i) {
        unsigned char byte = static_cast<unsigned char>(text[i]);
        if (byte == '%') {
            const char* const digits = text.data() + i + 1;
            if (text.size() - i < 3 ||
                std::from_chars(digits, digits + 2, byte, 16).ptr != digits + 2)
                return std::nullopt;
            i += 2;
        }
        bytes.push_back(byte);
    }
    return bytes;
}

}  // namespace

std::string without_animations(const std::string& json) {
    Json root = Json::parse(json, nullptr, false);
    if (root.is_object()) root.erase("animations");
    return root.dump();
}

std::optional<std::vector<unsigned char>> decode_data_uri(std::string_view uri) {
    const std::size_t comma = uri.find(',');
    if (!uri.starts_with("data:") || comma == std::string_view::npos) return std::nullopt;
    const std::string_view header = uri.substr(0, comma);
    const std::string_view content = uri.substr(comma + 1);
    return header.ends_with(";base64") ? decode_base64(content) : decode_percent(content);
}

Result<Rewritten> rewrite(std::span<const std::byte> json, std::span<const std::byte> binary,
                          Upload& upload) {
    const auto* const first = reinterpret_cast<const char*>(json.data());
    Json root = Json::parse(first, first + json.size(), nullptr, false);
    Rewritten out;
    if (root.is_object()) {
        write_integers(root);
        if (auto done = take_buffers(root, binary, upload, out); !done)
            return tl::unexpected<Error>(done.error());
        if (auto done = take_images(root, upload, out); !done)
            return tl::unexpected<Error>(done.error());
        if (Json* const accessors = objects_of(root, "accessors")) {
            state_types(*accessors, out);
            place_indices(root, *accessors, out);
        }
        if (Json* const views = objects_of(root, "bufferViews")) take_odd_strides(*views, out);
        if (Json* const cameras = objects_of(root, "cameras")) complete_cameras(*cameras);
        complete_lights(root);
        if (Json* const materials = objects_of(root, "materials"))
            drop_short_colours(*materials, out);
    }
    out.json = root.dump();
    return out;
}

}  // namespace raynest::gltf
