#include "client/film_file.h"

#include <algorithm>
#include <cstring>
#include <optional>

namespace raynest::client {
namespace {

constexpr std::uint32_t magic = 20000630;
constexpr std::size_t attributes_max = 256;
constexpr std::string_view prefix = "raynest:";

/// Reads values one after the other, never beyond the end.
class Reader {
public:
    explicit Reader(std::span<const std::byte> bytes) : rest_(bytes) {}
    std::optional<std::span<const std::byte>> take(std::size_t count) {
        if (count > rest_.size()) return std::nullopt;
        const auto taken = rest_.first(count);
        rest_ = rest_.subspan(count);
        return taken;
    }
    std::optional<std::uint32_t> word() {
        const auto bytes = take(4);
        if (!bytes) return std::nullopt;
        std::uint32_t value = 0;
        std::memcpy(&value, bytes->data(), sizeof value);
        return value;
    }
    /// A text that ends in 0.
    std::optional<std::string> name() {
        const auto end = std::ranges::find(rest_, std::byte{0});
        if (end == rest_.end()) return std::nullopt;
        const auto length = static_cast<std::size_t>(end - rest_.begin());
        std::string text(reinterpret_cast<const char*>(rest_.data()), length);
        rest_ = rest_.subspan(length + 1);
        return text;
    }

private:
    std::span<const std::byte> rest_;
};

}  // namespace

std::string FilmFile::value(const std::string& name) const {
    const auto found = attributes.find(name);
    return found == attributes.end() ? "" : found->second;
}

Result<FilmFile> read_film_file(std::span<const std::byte> file, const std::string& name) {
    const auto refuse = [&](const char* why) {
        return fail(Exit::invalid, name + " " + why +
                                       "; resume takes an EXR that render --integrator ao, direct "
                                       "or path has written");
    };
    Reader in(file);
    if (in.word() != magic || !in.word()) return refuse("is no EXR");
    FilmFile film;
    for (std::size_t count = 0;; ++count) {
        const auto key = in.name();
        if (!key || count > attributes_max) return refuse("is cut short");
        if (key->empty()) break;
        const auto type = in.name();
        const auto size = in.word();
        const auto value = size ? in.take(*size) : std::nullopt;
        if (!type || !value) return refuse("is cut short");
        if (*key == "dataWindow" && *size == 16) {
            std::uint32_t window[4];
            std::memcpy(window, value->data(), sizeof window);
            film.width = window[2] - window[0] + 1;
            film.height = window[3] - window[1] + 1;
        }
        if (*type == "string" && key->starts_with(prefix))
            film.attributes[key->substr(prefix.size())] =
                std::string(reinterpret_cast<const char*>(value->data()), value->size());
    }
    if (film.value("integrator").empty()) return refuse("is no lit picture of RayNest's");
    return film;
}

}  // namespace raynest::client
