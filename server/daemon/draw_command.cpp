#include "server/daemon/draw_command.h"

#include "engine/assets/images/image.h"
#include "engine/integrators/picture.h"
#include "protocol/limits.h"

#include <nlohmann/json.hpp>

#include <cstddef>
#include <cstdint>
#include <istream>
#include <ostream>
#include <span>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

template <class Value>
Result<Picture> picture_of(ImageSize size, std::span<const Value> counts,
                           const HeatOptions& options) {
    const auto statistics = heat_statistics(counts, options);
    if (!statistics) return tl::unexpected(statistics.error());
    return heat_picture(size.width, size.height, counts, *statistics, options);
}

Result<std::vector<std::byte>> drawn(const nlohmann::json& asked, std::istream& in) {
    const ImageSize size{asked.at("width"), asked.at("height")};
    if (size.pixels() == 0 || size.pixels() > protocol::Limits{}.picture_pixels_max)
        return fail(ErrorCode::limit_exceeded,
                    "a heat map with a legend has 1 to " +
                        std::to_string(protocol::Limits{}.picture_pixels_max) + " pixels");
    std::vector<std::uint32_t> counts(size.pixels());
    const auto bytes = static_cast<std::streamsize>(counts.size() * sizeof counts[0]);
    if (!in.read(reinterpret_cast<char*>(counts.data()), bytes))
        return fail(ErrorCode::param_invalid, "there are fewer counts than pixels");
    const HeatOptions options{.metric = asked.at("metric"),
                              .palette = asked.at("palette"),
                              .scale = asked.at("scale"),
                              .range = asked.at("range"),
                              .count = asked.at("count"),
                              .view = asked.at("view")};
    const std::span<const std::int32_t> differences{
        reinterpret_cast<const std::int32_t*>(counts.data()), counts.size()};
    const auto picture = asked.at("differs").get<bool>()
                             ? picture_of(size, differences, options)
                             : picture_of(size, std::span<const std::uint32_t>(counts), options);
    if (!picture) return tl::unexpected(picture.error());
    std::vector<Attribute> attributes;
    for (const auto& [name, value] : asked.at("attributes").items())
        attributes.push_back({name, value.get<std::string>()});
    return encode_png(picture->width, picture->height, picture->rgba, attributes);
}

}  // namespace

int draw_heat_map(std::istream& in, std::ostream& out, std::ostream& said) try {
    std::string line;
    std::getline(in, line);
    const auto file = drawn(nlohmann::json::parse(line), in);
    if (!file) {
        said << "raynestd: " << file.error().message << '\n';
        return 1;
    }
    out.write(reinterpret_cast<const char*>(file->data()),
              static_cast<std::streamsize>(file->size()));
    if (out.flush()) return 0;
    said << "raynestd: cannot write stdout\n";
    return 1;
} catch (const nlohmann::json::exception& error) {
    said << "raynestd: draw is for raynest merge, which says what it draws: " << error.what()
         << '\n';
    return 1;
}

}  // namespace raynest::server
