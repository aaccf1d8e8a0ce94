#include "server/jobs/films/received_picture.h"

#include "engine/assets/images/exr_header.h"
#include "engine/assets/sandbox/picture_child.h"
#include "protocol/text.h"
#include "server/store/import_memory.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <functional>
#include <string_view>
#include <type_traits>
#include <utility>

namespace raynest::server {
namespace {

/// Address space of a process that decodes a picture, beside the picture: mostly libraries.
constexpr std::uint64_t decoder_bytes = 1ULL << 30;

/// Runs a decoder in the import child, with room for the file and some copies of the picture.
/// `decode` gets the limits, and what tells whether the picture is still wanted.
template <class Decode>
auto decode_in_child(const Services& services, const std::string& principal,
                     std::uint64_t file_bytes, std::uint64_t picture_bytes, const Stop& stop,
                     const Decode& decode)
    -> Reply<typename std::invoke_result_t<Decode, const ImportLimits&,
                                           const StillWanted&>::value_type> {
    ImportLimits limits = services.import_limits;
    limits.image_bytes_max = picture_bytes;
    limits.bytes_max = std::min(limits.bytes_max, decoder_bytes + file_bytes + 4 * picture_bytes);
    ImportMemory memory(services.budget, principal, Use::passing);
    auto decoded = decode(
        limits, [&](std::uint64_t bytes) { return !stop.requested() && memory.cover(bytes); });
    if (stop.requested()) return refuse(Code::cancelled, "");
    if (memory.refused())
        return memory.refusal("decoding the picture",
                              "send a smaller one, or start raynestd with a "
                              "larger --memory");
    if (decoded) return std::move(*decoded);
    const Error& error = decoded.error();
    // Neither the daemon's own failures nor a lack of memory is the fault of the file.
    if (error.code == ErrorCode::internal || error.code == ErrorCode::out_of_memory ||
        error.code == ErrorCode::io_failed)
        return refuse(error);
    return refuse(Code::invalid_field, error.message);
}

/// Attributes that may differ between a file and the request that continues it.
bool may_differ(std::string_view name) {
    constexpr std::array<std::string_view, 4> names = {"raynest:spp", "raynest:scene",
                                                       "raynest:epoch", "Software"};
    return std::ranges::find(names, name) != names.end();
}

const std::string* find(std::span<const Attribute> attributes, std::string_view name) {
    const auto found = std::ranges::find(attributes, name, &Attribute::name);
    return found == attributes.end() ? nullptr : &found->value;
}

/// Compares the attributes of a file with those of the request that continues it.
Reply<void> check_attributes(std::span<const Attribute> file,
                             std::span<const Attribute> attributes) {
    for (const Attribute& wanted : attributes) {
        if (may_differ(wanted.name)) continue;
        const std::string* const found = find(file, wanted.name);
        if (found == nullptr)
            return refuse(Code::invalid_field, "the EXR to continue has no attribute " +
                                                   wanted.name +
                                                   ": it is no lit picture of "
                                                   "RayNest's");
        if (*found == wanted.value) continue;
        if (wanted.name == "raynest:hash")
            return refuse(Code::invalid_field,
                          "the EXR to continue was made of another scene, or the scene has changed "
                          "since: its hash " +
                              protocol::clean_text(*found, 64) + " is now " + wanted.value);
        if (wanted.name == "raynest:environment_hash")
            return refuse(
                Code::invalid_field,
                "the EXR to continue was lit by another picture than `environment` names");
        return refuse(Code::invalid_field, "the EXR to continue was made with " +
                                               wanted.name.substr(8) + " '" +
                                               protocol::clean_text(*found, 256) +
                                               "', the request has '" + wanted.value + "'");
    }
    // Files say what was hidden only if something was.
    for (const std::string_view name : {"raynest:hide", "raynest:only"})
        if (find(file, name) != nullptr && find(attributes, name) == nullptr)
            return refuse(Code::invalid_field, "the EXR to continue was made with " +
                                                   std::string(name.substr(8)) + " '" +
                                                   protocol::clean_text(*find(file, name), 256) +
                                                   "', the request has none");
    return {};
}

tl::unexpected<protocol::Error> damaged(const std::string& why) {
    return refuse(Code::invalid_field, "the EXR to continue is damaged: " + why);
}

}  // namespace

std::uint64_t environment_room(std::uint64_t file_bytes) {
    // A small file may be compressed well.
    constexpr std::uint64_t least = 64ULL << 20;
    return std::max(least, 16 * file_bytes);
}

Reply<std::shared_ptr<const EnvironmentPicture>> read_environment(const Services& services,
                                                                  const std::string& principal,
                                                                  std::span<const std::byte> file,
                                                                  const Stop& stop) {
    auto decoded = decode_in_child(
        services, principal, file.size(), environment_room(file.size()), stop,
        [&](const ImportLimits& limits, const StillWanted& wanted) {
            return decode_environment_in_child(file, limits, services.import_child, wanted);
        });
    if (!decoded) return tl::unexpected(decoded.error());
    auto picture = std::make_shared<EnvironmentPicture>();
    picture->size = {decoded->width, decoded->height};
    picture->pixels = std::move(decoded->rgb);
    picture->left_out = decoded->left_out;
    return picture;
}

Reply<void> read_film(const Services& services, const std::string& principal,
                      std::span<const std::byte> file, std::span<const Attribute> attributes,
                      std::uint32_t samples, const Stop& stop, Film& film) {
    // The header's reader is our own and bounded by its limits; no decoder runs here.
    const auto header = read_exr_header(file);
    if (!header) return refuse(Code::invalid_field, header.error().message);
    if (auto same = check_attributes(header->attributes, attributes); !same) return same;
    std::array<ChannelType, film_layers> types;
    for (std::size_t i = 0; i < film_layers; ++i)
        types[i] = {std::string(film_layer_table()[i].name), film_layer_table()[i].is_float};
    const auto planes = decode_in_child(
        services, principal, file.size(), Film::bytes(film.size()), stop,
        [&](const ImportLimits& limits, const StillWanted& wanted) {
            return decode_exr_in_child(file, film.size().width, film.size().height, types, limits,
                                       services.import_child, wanted);
        });
    if (!planes) return tl::unexpected(planes.error());
    for (std::size_t i = 0; i < film_layers; ++i)
        std::ranges::copy((*planes)[i], film.words(static_cast<FilmLayer>(i)).begin());
    return check_film(film, samples);
}

Reply<void> check_film(const Film& film, std::uint32_t samples) {
    for (std::size_t i = 0; i < film_layers; ++i) {
        const FilmLayerInfo& info = film_layer_table()[i];
        const auto layer = static_cast<FilmLayer>(i);
        if (!info.is_float) continue;
        const std::span<const float> values = film.floats(layer);
        const auto wrong = std::ranges::find_if(values, [&](float value) {
            return !std::isfinite(value) || (layer == FilmLayer::variance && value < 0);
        });
        if (wrong == values.end()) continue;
        const auto at = static_cast<std::uint64_t>(wrong - values.begin());
        return damaged("layer " + std::string(info.name) + " of pixel " +
                       std::to_string(at % film.size().width) + "," +
                       std::to_string(at / film.size().width) +
                       (std::isfinite(*wrong) ? " is negative" : " is not finite"));
    }
    const auto made = film.words(FilmLayer::samples);
    const auto dropped = film.words(FilmLayer::dropped);
    for (std::size_t i = 0; i < made.size(); ++i) {
        const std::uint64_t taken = std::uint64_t{made[i]} + dropped[i];
        if (taken > protocol::Limits{}.samples_max)
            return damaged("a pixel has " + std::to_string(taken) + " samples, more than " +
                           std::to_string(protocol::Limits{}.samples_max));
        if (taken > samples)
            return refuse(Code::invalid_field,
                          "the EXR to continue has " + std::to_string(taken) +
                              " samples of a pixel: ask for more than that with `samples`");
    }
    return {};
}

}  // namespace raynest::server
