// The header of an OpenEXR file as a list of attributes, one after the other; clients read it, too.
// https://openexr.com/en/latest/OpenEXRFileLayout.html
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <string>
#include <utility>

namespace raynest {

inline constexpr std::uint32_t exr_magic = 20000630;

struct ExrAttribute {
    std::string name;  ///< empty: the header ends here
    std::string type = {};
    std::uint32_t size = 0;
    std::optional<std::span<const std::byte>> value = {};  ///< nothing: the file is cut short
};

/// Reads little-endian values one after the other, never beyond the end: where they are cut short,
/// nothing.
class ExrReader {
public:
    explicit ExrReader(std::span<const std::byte> bytes) : rest_(bytes) {}

    std::optional<std::uint32_t> word() {
        const auto bytes = take(4);
        if (!bytes) return std::nullopt;
        std::uint32_t value = 0;
        std::memcpy(&value, bytes->data(), sizeof value);
        return value;
    }
    /// A name that ends in 0, of at most 255 bytes.
    std::optional<std::string> name() {
        constexpr std::size_t bytes_max = 255;
        const auto window = rest_.first(std::min(rest_.size(), bytes_max + 1));
        const auto end = std::ranges::find(window, std::byte{0});
        if (end == window.end()) return std::nullopt;
        const auto length = static_cast<std::size_t>(end - window.begin());
        std::string text(reinterpret_cast<const char*>(window.data()), length);
        rest_ = rest_.subspan(length + 1);
        return text;
    }
    /// Nothing where the name is cut short.
    std::optional<ExrAttribute> attribute() {
        auto of = name();
        if (!of) return std::nullopt;
        ExrAttribute attribute{std::move(*of)};
        if (attribute.name.empty()) return attribute;
        const auto type = name();
        const auto size = word();
        if (!type || !size) return attribute;
        attribute.type = *type;
        attribute.size = *size;
        attribute.value = take(*size);
        return attribute;
    }

private:
    std::optional<std::span<const std::byte>> take(std::size_t count) {
        if (count > rest_.size()) return std::nullopt;
        const auto taken = rest_.first(count);
        rest_ = rest_.subspan(count);
        return taken;
    }

    std::span<const std::byte> rest_;
};

}  // namespace raynest
