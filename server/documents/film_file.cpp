#include "server/documents/film_file.h"

#include "server/documents/plan_text.h"

#include <array>
#include <cstddef>
#include <cstring>
#include <utility>

namespace raynest::server {

std::uint64_t film_payload_bytes_max(ImageSize size, std::string_view encode) {
    if (encode == "png") return png_bytes_max(size.width, size.height);
    if (encode == "exr") return exr_bytes_max(size.width, size.height, film_layers);
    return (encode == "linear" ? sizeof(Vec4) : 4) * size.pixels();
}

Reply<Payload> encode_film(const Film& film, std::string_view encode, const Look& look,
                           std::vector<Attribute> attributes) {
    const ImageSize size = film.size();
    Payload payload{size.width, size.height, {}};
    if (encode == "exr") {
        std::array<Channel, film_layers> channels;
        for (std::size_t i = 0; i < film_layers; ++i) {
            const FilmLayerInfo& layer = film_layer_table()[i];
            const auto id = static_cast<FilmLayer>(i);
            channels[i].name = layer.name;
            if (layer.is_float)
                channels[i].f32 = film.floats(id);
            else
                channels[i].u32 = film.words(id);
        }
        auto file = encode_exr(size.width, size.height, channels, attributes);
        if (!file) return refuse(file.error());
        payload.bytes = std::move(*file);
        return payload;
    }
    if (encode == "linear") {
        payload.bytes.resize(size.pixels() * sizeof(Vec4));
        for (std::uint64_t i = 0; i < size.pixels(); ++i) {
            const Vec4 colour = film.colour(i);
            std::memcpy(payload.bytes.data() + i * sizeof colour, &colour, sizeof colour);
        }
        payload.exposure = auto_exposure(film);
        return payload;
    }
    const float stops = look.exposure ? *look.exposure : auto_exposure(film);
    const Picture picture = show(film, {0, 0, size.width, size.height}, look.tonemap, stops);
    if (encode == "png") {
        attributes.push_back({"raynest:exposure", number_text(stops)});
        auto file = encode_png(picture.width, picture.height, picture.rgba, attributes);
        if (!file) return refuse(file.error());
        payload.bytes = std::move(*file);
        return payload;
    }
    payload.bytes.resize(picture.rgba.size());
    std::memcpy(payload.bytes.data(), picture.rgba.data(), picture.rgba.size());
    return payload;
}

}  // namespace raynest::server
