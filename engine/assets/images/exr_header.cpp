#include "engine/assets/images/exr_header.h"

#include "engine/assets/images/exr_attributes.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <optional>

namespace raynest {
namespace {

/// Version 2 of the format, perhaps with long names; no tiles, no parts, no deep data.
constexpr std::uint32_t version = 2;
constexpr std::uint32_t long_names = 0x400;
constexpr std::uint8_t zip_compression = 3;
constexpr std::uint32_t side_max = 1U << 20;

tl::unexpected<Error> broken_exr(const std::string& why) {
    return fail(ErrorCode::scene_invalid, "the EXR's header is not one of RayNest's: " + why);
}

/// The channels of an attribute of type chlist; nothing if they are no whole 32-bit channels.
std::optional<std::vector<ChannelType>> read_channels(std::span<const std::byte> bytes) {
    constexpr std::size_t most = 64;
    ExrReader in(bytes);
    std::vector<ChannelType> channels;
    while (true) {
        const auto name = in.name();
        if (!name || channels.size() > most) return std::nullopt;
        if (name->empty()) return channels;
        const auto type = in.word();
        const auto linear = in.word();
        const auto step_x = in.word();
        const auto step_y = in.word();
        if (!type || !linear || (*type != 0 && *type != 2) || step_x != 1U || step_y != 1U)
            return std::nullopt;
        channels.push_back({*name, *type == 2});
    }
}

}  // namespace

Result<ExrHeader> read_exr_header(std::span<const std::byte> file) {
    ExrReader in(file);
    if (in.word() != exr_magic) return fail(ErrorCode::scene_unsupported, "the file is not an EXR");
    const auto kind = in.word();
    if (!kind || (*kind & ~long_names) != version)
        return broken_exr("it has tiles, several parts or deep data");
    ExrHeader header;
    std::array<bool, 3> seen{};  // channels, compression, data window
    for (std::size_t count = 0;; ++count) {
        const auto attribute = in.attribute();
        if (!attribute) return broken_exr("it is cut short");
        const auto& [name, type, size, value] = *attribute;
        if (name.empty()) break;
        if (count == exr_attributes_max) return broken_exr("it has too many attributes");
        if (size > exr_attribute_bytes_max)
            return broken_exr("attribute '" + name + "' is too long");
        if (!value) return broken_exr("attribute '" + name + "' is cut short");
        if (name == "channels") {
            auto channels = read_channels(*value);
            if (!channels || seen[0]) return broken_exr("its channels are not whole 32-bit ones");
            header.channels = std::move(*channels);
            seen[0] = true;
        } else if (name == "compression") {
            if (size != 1 || std::to_integer<std::uint8_t>(value->front()) != zip_compression)
                return broken_exr("it is not compressed with ZIP");
            seen[1] = true;
        } else if (name == "dataWindow" || name == "displayWindow") {
            std::array<std::uint32_t, 4> window{};
            if (size != sizeof window) return broken_exr("its window is invalid");
            std::memcpy(window.data(), value->data(), sizeof window);
            if (window[0] != 0 || window[1] != 0 || window[2] >= side_max || window[3] >= side_max)
                return broken_exr("its window does not begin at 0,0 or is too large");
            if (seen[2] && (header.width != window[2] + 1 || header.height != window[3] + 1))
                return broken_exr("its windows differ");
            header.width = window[2] + 1;
            header.height = window[3] + 1;
            seen[2] = true;
        } else if (type == "string") {
            header.attributes.push_back(
                {name, std::string(reinterpret_cast<const char*>(value->data()), size)});
        }
    }
    for (const bool found : seen)
        if (!found) return broken_exr("channels, compression or window are missing");
    return header;
}

Result<std::vector<std::size_t>> find_channels(const ExrHeader& header, std::uint32_t width,
                                               std::uint32_t height,
                                               std::span<const ChannelType> channels) {
    const auto pixels = [](std::uint32_t columns, std::uint32_t rows) {
        return std::to_string(columns) + "x" + std::to_string(rows);
    };
    if (header.width != width || header.height != height)
        return fail(ErrorCode::scene_invalid, "the EXR has " + pixels(header.width, header.height) +
                                                  " pixels, not " + pixels(width, height));
    // Equally many, and each has a place of its own: then there are no others.
    std::vector<std::size_t> places;
    for (const ChannelType& channel : channels) {
        const auto found = std::ranges::find(header.channels, channel);
        const auto place = static_cast<std::size_t>(found - header.channels.begin());
        if (found == header.channels.end() || header.channels.size() != channels.size() ||
            std::ranges::find(places, place) != places.end())
            return fail(ErrorCode::scene_invalid, "the EXR has other channels");
        places.push_back(place);
    }
    return places;
}

}  // namespace raynest
