#include "engine/assets/gltf/file/uri.h"

#include <charconv>

namespace raynest::gltf {
namespace {

/// Returns the letter of "%41" at the start of a text; nothing if that is none.
std::optional<char> percent_code(std::string_view text) {
    unsigned code = 0;
    const char* const digits = text.data() + 1;
    if (text.size() < 3 || std::from_chars(digits, digits + 2, code, 16).ptr != digits + 2)
        return std::nullopt;
    return static_cast<char>(code);
}

/// Decodes one part of a path. What is encoded must not become part of the path's structure.
std::optional<std::string> decode_part(std::string_view part) {
    std::string decoded;
    for (std::size_t i = 0; i < part.size(); ++i) {
        char c = part[i];
        if (c == '%') {
            const auto code = percent_code(part.substr(i));
            if (!code) return std::nullopt;
            c = *code;
            i += 2;
        }
        const bool is_structure = c == '/' || c == '\\' || c == ':';
        if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F || is_structure) return std::nullopt;
        decoded += c;
    }
    if (decoded == "." || decoded == "..") return std::nullopt;
    return decoded;
}

}  // namespace

std::optional<std::string> file_of_uri(std::string_view uri) {
    constexpr std::size_t name_bytes_max = 1024;
    constexpr std::string_view separators = "/\\";
    const auto is_separator = [&](char c) { return separators.find(c) != separators.npos; };
    if (uri.empty() || uri.size() > 3 * name_bytes_max || is_separator(uri.front()) ||
        is_separator(uri.back()))
        return std::nullopt;
    std::string name;
    for (std::string_view rest = uri;;) {
        const std::string_view part = rest.substr(0, rest.find_first_of(separators));
        if (part == "..") {
            if (name.empty()) return std::nullopt;
            const std::size_t parent = name.rfind('/');
            name.resize(parent == std::string::npos ? 0 : parent);
        } else if (!part.empty() && part != ".") {
            const auto decoded = decode_part(part);
            if (!decoded) return std::nullopt;
            if (!name.empty()) name += '/';
            name += *decoded;
        }
        if (part.size() == rest.size()) break;
        rest.remove_prefix(part.size() + 1);
    }
    if (name.empty() || name.size() > name_bytes_max) return std::nullopt;
    return name;
}

std::string_view why_no_file(std::string_view uri) {
    if (uri.empty()) return "is empty; name a file beside the scene";
    const std::size_t colon = uri.find(':');
    if (uri.starts_with('/') || uri.starts_with('\\') || colon == 1)
        return "is an absolute path; name the file relative to the scene";
    if (colon != std::string_view::npos)
        return "is an address; only files beside or below the scene are read";
    for (std::size_t at = uri.find('%'); at != uri.npos; at = uri.find('%', at + 1)) {
        if (!percent_code(uri.substr(at)))
            return "has a % without two hex digits behind it; write %25 for the letter %";
    }
    return "is not beside or below the scene";
}

}  // namespace raynest::gltf
