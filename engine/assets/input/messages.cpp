#include "engine/assets/input/messages.h"

#include <fmt/format.h>

#include <algorithm>

namespace raynest {
namespace {

/// True if this byte continues a UTF-8 character.
bool is_inside(char byte) {
    return (static_cast<unsigned char>(byte) & 0xC0U) == 0x80U;
}

}  // namespace

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

}  // namespace raynest
