#include "client/files/gltf_names.h"

#include "protocol/text.h"
#include "protocol/validate.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstring>
#include <map>

namespace raynest::client {
namespace {

using nlohmann::json;

/// Reads the JSON and keeps buffers[*].uri and images[*].uri.
class UriCollector : public json::json_sax_t {
public:
    std::vector<GltfFile> uris;  ///< not yet decoded
    std::string error;

    bool null() override { return value(); }
    bool boolean(bool) override { return value(); }
    bool number_integer(number_integer_t) override { return value(); }
    bool number_unsigned(number_unsigned_t) override { return value(); }
    bool number_float(number_float_t, const string_t&) override { return value(); }
    bool binary(binary_t&) override { return value(); }
    bool string(string_t& text) override {
        if (depth_ == 3 && key_ == "uri" && (list_ == "buffers" || list_ == "images"))
            uris.push_back({text, list_ == "images"});
        return value();
    }
    bool key(string_t& name) override {
        // A key in the root begins a list; the list ends at the next key there.
        if (depth_ == 1) list_ = name;
        key_ = name;
        return true;
    }
    bool start_object(std::size_t) override { return enter(); }
    bool start_array(std::size_t) override {
        if (depth_ == 0) return refuse("is not a JSON object");
        return enter();
    }
    bool end_object() override { return leave(); }
    bool end_array() override { return leave(); }
    bool parse_error(std::size_t position, const std::string&,
                     const nlohmann::detail::exception&) override {
        return refuse("is not valid JSON (byte " + std::to_string(position) + ")");
    }

private:
    bool refuse(std::string why) {
        error = std::move(why);
        return false;
    }
    bool value() { return depth_ > 0 || refuse("is not a JSON object"); }
    bool enter() {
        key_.clear();
        return ++depth_ <= json_depth_max ||
               refuse("is nested deeper than " + std::to_string(json_depth_max) + " levels");
    }
    bool leave() {
        --depth_;
        key_.clear();
        return true;
    }

    std::size_t depth_ = 0;
    std::string list_;  ///< the last key of the root
    std::string key_;   ///< the last key of the innermost object
};

std::uint32_t word_at(std::span<const std::byte> bytes, std::size_t offset) {
    std::uint32_t value = 0;
    std::memcpy(&value, bytes.data() + offset, sizeof value);
    return value;
}

constexpr std::uint32_t glb_magic = 0x46546C67;  // "glTF"
constexpr std::uint32_t json_chunk = 0x4E4F534A;
constexpr std::size_t glb_header_bytes = 12;
constexpr std::size_t chunk_header_bytes = 8;

/// Reads the header and the first chunk, which must be JSON.
Result<std::span<const std::byte>> glb_json(std::span<const std::byte> file) {
    if (file.size() < glb_header_bytes) return fail(Exit::invalid, "is cut within its GLB header");
    if (word_at(file, 4) != 2)
        return fail(Exit::invalid, "is GLB version " + std::to_string(word_at(file, 4)) +
                                       "; only version 2 can be read");
    if (word_at(file, 8) > file.size())
        return fail(Exit::invalid, "says that it has " + std::to_string(word_at(file, 8)) +
                                       " bytes, but has " + std::to_string(file.size()));
    file = file.first(word_at(file, 8));  // ignore bytes behind the declared length
    if (file.size() < glb_header_bytes + chunk_header_bytes)
        return fail(Exit::invalid, "is cut within its GLB header");
    std::span<const std::byte> found;
    for (std::size_t at = glb_header_bytes; at < file.size();) {
        if (file.size() - at < chunk_header_bytes)
            return fail(Exit::invalid, "is cut within a chunk header");
        const std::size_t bytes = word_at(file, at);
        if (bytes > file.size() - at - chunk_header_bytes)
            return fail(Exit::invalid, "has a chunk that ends beyond the file");
        if (at == glb_header_bytes) {
            if (word_at(file, at + 4) != json_chunk)
                return fail(Exit::invalid, "does not begin with a JSON chunk");
            found = file.subspan(at + chunk_header_bytes, bytes);
        }
        at += chunk_header_bytes + bytes;
    }
    return found;
}

/// Decodes one part of a path. Encoded characters must not change the path's structure.
std::optional<std::string> decode_part(std::string_view part) {
    std::string decoded;
    for (std::size_t i = 0; i < part.size(); ++i) {
        if (part[i] != '%') {
            decoded += part[i];
            continue;
        }
        const auto letter = protocol::percent_code(part.substr(i));
        if (!letter) return std::nullopt;
        decoded += *letter;
        i += 2;
    }
    if (!protocol::printable(decoded) || decoded.find_first_of("/\\:") != std::string::npos ||
        decoded == "." || decoded == "..")
        return std::nullopt;
    return decoded;
}

/// Returns the first letters of a file in quotes, or its first bytes in hex.
std::string beginning_of(std::string_view text) {
    constexpr std::size_t letters = 32, bytes = 8;
    const std::string_view line = text.substr(0, std::min(text.find_first_of("\r\n"), letters));
    if (!line.empty() && protocol::printable(line)) return "'" + std::string(line) + "'";
    std::string hex = "the bytes";
    for (const char c : text.substr(0, bytes)) {
        constexpr std::string_view digits = "0123456789abcdef";
        const auto byte = static_cast<unsigned char>(c);
        hex += {' ', digits[byte >> 4U], digits[byte & 15U]};
    }
    return hex;
}

}  // namespace

std::string why_no_gltf(std::span<const std::byte> file, bool is_glb) {
    const std::string_view text(reinterpret_cast<const char*>(file.data()), file.size());
    if (text.starts_with("version https://git-lfs"))
        return "is a Git LFS pointer, not the file itself: run git lfs pull";
    if (!is_glb || text.starts_with("glTF")) return {};
    if (text.empty()) return "is empty";
    return "is no GLB file: it begins with " + beginning_of(text) +
           (text.starts_with('{') ? "; name a file of JSON .gltf" : "");
}

Result<std::span<const std::byte>> gltf_json(std::span<const std::byte> file) {
    const bool binary = file.size() >= 4 && word_at(file, 0) == glb_magic;
    Result<std::span<const std::byte>> text = file;
    if (binary) text = glb_json(file);
    if (text && text->size() > json_bytes_max)
        return fail(Exit::invalid, "has " + std::to_string(text->size()) +
                                       " bytes of JSON; at most " + std::to_string(json_bytes_max) +
                                       " are read");
    return text;
}

std::optional<std::string> file_of_uri(std::string_view uri) {
    constexpr std::string_view separators = "/\\";
    const auto is_separator = [&](char c) { return separators.find(c) != separators.npos; };
    if (uri.empty() || is_separator(uri.front()) || is_separator(uri.back())) return std::nullopt;
    std::vector<std::string> parts;
    for (std::size_t begin = 0; begin <= uri.size();) {
        const std::size_t end = std::min(uri.find_first_of(separators, begin), uri.size());
        const std::string_view part = uri.substr(begin, end - begin);
        begin = end + 1;
        if (part.empty() || part == ".") continue;
        if (part != "..") {
            auto decoded = decode_part(part);
            if (!decoded) return std::nullopt;
            parts.push_back(std::move(*decoded));
        } else if (parts.empty()) {
            return std::nullopt;
        } else {
            parts.pop_back();
        }
    }
    std::string name;
    for (const std::string& part : parts) name += (name.empty() ? "" : "/") + part;
    constexpr std::size_t name_bytes_max = 1024;
    if (name.empty() || name.size() > name_bytes_max) return std::nullopt;
    return name;
}

Result<std::vector<GltfFile>> gltf_names(std::span<const std::byte> json_text) {
    UriCollector collector;
    const char* begin = reinterpret_cast<const char*>(json_text.data());
    if (!json::sax_parse(begin, begin + json_text.size(), &collector))
        return fail(Exit::invalid, collector.error);
    std::vector<GltfFile> files;
    std::map<std::string, std::size_t> places;
    for (const GltfFile& uri : collector.uris) {
        if (uri.name.starts_with("data:")) continue;
        auto name = file_of_uri(uri.name);
        if (!name) continue;
        const auto [known, is_new] = places.try_emplace(*name, files.size());
        if (is_new)
            files.push_back({std::move(*name), uri.is_picture});
        else
            files[known->second].is_picture &= uri.is_picture;
    }
    return files;
}

}  // namespace raynest::client
