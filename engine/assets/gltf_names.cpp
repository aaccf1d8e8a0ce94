#include "engine/assets/gltf_names.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace raynest::gltf {
namespace {

/// Is this byte a later one of a UTF-8 character?
bool is_inside(char byte) {
    return (static_cast<unsigned char>(byte) & 0xC0U) == 0x80U;
}

}  // namespace

bool is_safe_name(std::string_view uri) {
    if (uri.empty() || uri.size() > 4096 || uri.front() == '/' || uri.front() == '~') return false;
    for (std::size_t i = 0; i < uri.size(); ++i) {
        const auto c = static_cast<unsigned char>(uri[i]);
        if (c < 0x20 || c == 0x7F || c == '\\' || c == ':') return false;
        if (c != '%') continue;
        // What a percent sign hides must not be part of the path's structure, or another percent
        // sign.
        const std::string_view code = uri.substr(i + 1, 2);
        for (const char* hidden :
             {"2e", "2E", "2f", "2F", "5c", "5C", "25", "3a", "3A", "7f", "7F"}) {
            if (code == hidden) return false;
        }
        if (code.size() < 2 || code[0] == '0' || code[0] == '1') return false;
    }
    for (std::size_t at = 0; at <= uri.size();) {
        const std::size_t end = std::min(uri.find('/', at), uri.size());
        const std::string_view part = uri.substr(at, end - at);
        if (part.empty() || part == "..") return false;
        at = end + 1;
    }
    return true;
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

bool Upload::has(std::string_view name) {
    if (find(name) != nullptr) return true;
    if (missing_.empty()) missing_ = name;
    return false;
}

Result<std::span<const std::byte>> Upload::read(std::string_view name) {
    const NamedBytes* file = find(name);
    if (file == nullptr || file->bytes.size() > bytes_left_) {
        return fail(ErrorCode::limit_exceeded, "the scene names the same file again and again");
    }
    bytes_left_ -= file->bytes.size();
    return file->bytes;
}

tl::unexpected<Error> Upload::missing_file() const {
    if (missing_.empty() || missing_ == "./") {
        return fail(ErrorCode::scene_invalid,
                    "a buffer of the scene has no data: it names no file");
    }
    if (missing_.starts_with("data:")) {
        return fail(ErrorCode::scene_invalid,
                    "the scene has a data URI that is not base64 of a known type");
    }
    return fail(ErrorCode::scene_invalid,
                fmt::format("the scene names the file '{}', which did not come with it",
                            one_line(missing_)));
}

const NamedBytes* Upload::find(std::string_view name) const {
    while (name.starts_with("./")) name.remove_prefix(2);
    if (!is_safe_name(name)) return nullptr;
    // files[0] is the scene itself.
    for (std::size_t i = 1; i < request_.files.size(); ++i) {
        if (request_.files[i].name == name) return &request_.files[i];
    }
    return nullptr;
}

}  // namespace raynest::gltf
