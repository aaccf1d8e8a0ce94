#include "engine/assets/gltf_names.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <utility>

namespace raynest::gltf {
namespace {

/// Is this byte a later one of a UTF-8 character?
bool is_inside(char byte) {
    return (static_cast<unsigned char>(byte) & 0xC0U) == 0x80U;
}

}  // namespace

std::optional<std::string> file_of_uri(std::string_view uri) {
    constexpr std::size_t name_bytes_max = 1024;
    if (uri.empty() || uri.size() > 3 * name_bytes_max) return std::nullopt;
    std::string decoded;
    for (std::size_t i = 0; i < uri.size(); ++i) {
        char c = uri[i];
        if (c == '%') {
            unsigned code = 0;
            const char* const digits = uri.data() + i + 1;
            const char* const end = digits + 2;
            if (uri.size() - i < 3 || std::from_chars(digits, end, code, 16).ptr != end) {
                return std::nullopt;
            }
            c = static_cast<char>(code);
            i += 2;
            // An encoded dot or slash must not become part of the path's structure.
            if (c == '.' || c == '/') return std::nullopt;
        }
        if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F || c == '\\' || c == ':') {
            return std::nullopt;
        }
        decoded += c;
    }
    std::string name;
    for (std::string_view rest = decoded;;) {
        const std::string_view part = rest.substr(0, rest.find('/'));
        if (part.empty()) return std::nullopt;
        if (part == "..") {
            if (name.empty()) return std::nullopt;
            const std::size_t parent = name.rfind('/');
            name.resize(parent == std::string::npos ? 0 : parent);
        } else if (part != ".") {
            if (!name.empty()) name += '/';
            name += part;
        }
        if (part.size() == rest.size()) break;
        rest.remove_prefix(part.size() + 1);
    }
    if (name.empty() || name.size() > name_bytes_max) return std::nullopt;
    return name;
}

std::string_view front_of(std::string_view text, std::size_t bytes_max) {
    if (text.size() <= bytes_max) return text;
    while (bytes_max > 0 && is_inside(text[bytes_max])) --bytes_max;
    return text.substr(0, bytes_max);
}

void leave_out(SceneDescription& scene, const std::string& kind, std::string why) {
    constexpr std::uint64_t warnings_max = 8;  // of a kind
    const std::uint64_t count = ++scene.skipped[kind];
    if (count <= warnings_max) scene.warnings.push_back(std::move(why));
    if (count == warnings_max + 1) scene.warnings.push_back("more " + kind + " are left out");
}

std::string one_line(std::string_view text, std::size_t length_max) {
    std::string line(front_of(text, length_max));
    for (char& c : line) {
        if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = ' ';
    }
    while (!line.empty() && line.back() == ' ') line.pop_back();
    if (text.size() > length_max) line += "...";
    return line;
}

std::string label(std::string_view kind, std::uint64_t index, std::string_view name) {
    if (name.empty()) return fmt::format("{} {}", kind, index);
    return fmt::format("{} {} ('{}')", kind, index, one_line(name, 60));
}

Result<std::span<const std::byte>> Upload::read(std::string_view name) {
    // files[0] is the scene itself.
    const auto others = std::span(request_.files).subspan(1);
    const auto file = std::find_if(others.begin(), others.end(),
                                   [&](const NamedBytes& other) { return other.name == name; });
    if (file == others.end()) return std::span<const std::byte>();
    if (file->bytes.size() > bytes_left_) {
        return fail(ErrorCode::limit_exceeded, "the scene names the same file again and again");
    }
    bytes_left_ -= file->bytes.size();
    return file->bytes;
}

}  // namespace raynest::gltf
