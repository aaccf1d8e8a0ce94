#include "engine/assets/gltf_names.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <utility>

namespace raynest::gltf {
namespace {

/// True if this byte continues a UTF-8 character.
bool is_inside(char byte) {
    return (static_cast<unsigned char>(byte) & 0xC0U) == 0x80U;
}

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

std::string_view front_of(std::string_view text, std::size_t bytes_max) {
    if (text.size() <= bytes_max) return text;
    while (bytes_max > 0 && is_inside(text[bytes_max])) --bytes_max;
    return text.substr(0, bytes_max);
}

void Oddities::add(const std::string& where, const std::string& what, std::uint64_t more) {
    const auto same = std::find_if(found_.begin(), found_.end(),
                                   [&](const First& first) { return first.what == what; });
    if (same == found_.end())
        found_.push_back({where, what, more});
    else
        same->more += 1 + more;
}

void Oddities::append_to(std::vector<std::string>& warnings) const {
    for (const auto& [where, what, more] : found_) {
        const std::string others =
            more == 0 ? "" : fmt::format(" and {} other{}", more, more == 1 ? "" : "s");
        warnings.push_back(fmt::format("{}{}: {}", where, others, what));
    }
}

void leave_out(SceneDescription& scene, const std::string& kind, std::string why) {
    constexpr std::uint64_t warnings_max = 8;  // per kind
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

std::string counted(std::uint64_t count, std::string_view one, std::string_view many) {
    return fmt::format("{} {}", count, count == 1 ? one : many);
}

Result<std::span<const std::byte>> Upload::read(std::string_view name) {
    // files[0] is the scene itself.
    const auto others = std::span(request_.files).subspan(1);
    const auto file = std::find_if(others.begin(), others.end(),
                                   [&](const NamedBytes& other) { return other.name == name; });
    if (file == others.end()) return std::span<const std::byte>();
    if (file->bytes.size() > bytes_left_) {
        return fail(ErrorCode::limit_exceeded, "the scene names the same file repeatedly");
    }
    bytes_left_ -= file->bytes.size();
    return file->bytes;
}

}  // namespace raynest::gltf
