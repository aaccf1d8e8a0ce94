// Pictures through OpenImageIO: the only file that includes it, and a loadable module of its own.
//
// Image decoders are a common target of attacks (this version has a row of CVEs), so the order is
// fixed: magic bytes choose one of three decoders, the header's dimensions are checked against the
// limits, and only then is a pixel decoded. Nothing here reads or writes a file.
#include "engine/assets/images/image_module.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#ifdef RAYNEST_WEBP
#include <webp/decode.h>
#endif

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <memory>
#include <mutex>
#include <new>
#include <optional>
#include <string>
#include <system_error>
#include <utility>

namespace raynest {
namespace {

namespace oiio = OIIO;

/// Sets one decoder thread, so that a picture costs only its own pixels, and OpenImageIO's own size
/// limit as a second check behind ours.
void configure_once() {
    static std::once_flag once;
    std::call_once(once, [] {
        oiio::attribute("threads", 1);
        oiio::attribute("limits:channels", 64);  // a film's; decode() allows 4
        oiio::attribute("limits:imagesize_MB", 2048);
    });
}

/// Rows of a block of an EXR with ZIP compression.
constexpr std::uint32_t exr_block_rows = 16;

bool starts_with(std::span<const std::byte> file, std::string_view magic, std::size_t at = 0) {
    return file.size() >= at + magic.size() &&
           std::memcmp(file.data() + at, magic.data(), magic.size()) == 0;
}

/// Returns the file name that selects OpenImageIO's plugin; empty if the format is not supported.
std::string plugin_name(std::span<const std::byte> file) {
    if (starts_with(file, "\x89PNG\r\n\x1A\n")) return "memory.png";
    if (starts_with(file, "\xFF\xD8\xFF")) return "memory.jpg";
    if (starts_with(file, "RIFF") && starts_with(file, "WEBP", 8)) return "memory.webp";
    return {};
}

/// Walks a JPEG's markers to the end-of-image one.
bool has_jpeg_end(std::span<const std::byte> file) {
    const auto at = [&](std::size_t i) { return std::to_integer<unsigned>(file[i]); };
    std::size_t i = 2;
    bool in_scan = false;
    while (i + 1 < file.size()) {
        if (at(i) != 0xFF) {
            if (!in_scan) return false;
            ++i;
            continue;
        }
        const unsigned marker = at(i + 1);
        const bool stuffed_or_restart = marker == 0 || (marker >= 0xD0 && marker <= 0xD7);
        if (marker == 0xFF) {
            ++i;  // fill byte
        } else if (stuffed_or_restart) {
            i += 2;
        } else if (marker == 0xD9) {
            return true;
        } else {
            if (i + 3 >= file.size()) return false;
            in_scan = marker == 0xDA;
            i += 2 + (at(i + 2) << 8 | at(i + 3));
        }
    }
    return false;
}

/// Converts grey, grey + alpha, RGB or RGBA to RGBA, without a switch per pixel.
std::vector<std::uint8_t> to_rgba(const std::vector<std::uint8_t>& pixels, std::size_t count,
                                  std::size_t channels) {
    std::vector<std::uint8_t> rgba(count * 4);
    const bool grey = channels <= 2;
    const bool alpha = channels == 2 || channels == 4;
    for (std::size_t i = 0; i < count; ++i) {
        const std::uint8_t* in = pixels.data() + i * channels;
        std::uint8_t* out = rgba.data() + i * 4;
        out[0] = in[0];
        out[1] = grey ? in[0] : in[1];
        out[2] = grey ? in[0] : in[2];
        out[3] = alpha ? in[channels - 1] : std::uint8_t{255};
    }
    return rgba;
}

/// Divides colours by alpha: OpenImageIO's WebP reader multiplies them whatever its settings. This
/// loses digits where a pixel is almost transparent, and all colour where it is wholly so:
/// decode_webp() reads what it can.
void divide_by_alpha(std::vector<std::uint8_t>& rgba) {
    for (std::size_t i = 0; i < rgba.size(); i += 4) {
        const unsigned alpha = rgba[i + 3];
        if (alpha == 0 || alpha == 255) continue;
        for (std::size_t c = 0; c < 3; ++c) {
            const unsigned straight = (rgba[i + c] * 255U + alpha / 2) / alpha;
            rgba[i + c] = static_cast<std::uint8_t>(std::min(straight, 255U));
        }
    }
}

constexpr const char* no_memory_to_decode = "no memory left to decode the picture";

/// Memory that a decoder written in C may need in addition to the pixels.
constexpr std::size_t decoder_bytes = 32U << 20;

/// Reports a decoder's failure. C decoders report lack of memory as a broken file, so `why` is
/// reported only if `bytes` and more can be allocated.
tl::unexpected<Error> decode_failed(std::uint64_t bytes, const char* why) {
    void* const room = ::operator new(bytes + decoder_bytes, std::nothrow);
    ::operator delete(room);
    if (room == nullptr) return fail(ErrorCode::out_of_memory, no_memory_to_decode);
    return fail(ErrorCode::scene_invalid, why);
}

tl::unexpected<Error> encode_failed(std::string_view name, const std::string& why) {
    return fail(ErrorCode::internal, fmt::format("{} was not encoded: {}", name, why));
}

tl::unexpected<Error> no_memory_to_encode() {
    return fail(ErrorCode::out_of_memory, "no memory left to encode the picture");
}

/// Opens `output` on a growing buffer, writes one image and closes it. `write` passes the pixels to
/// the output, false if that fails.
template <class Write>
Result<std::vector<std::byte>> write_to_memory(const char* name, const oiio::ImageSpec& spec,
                                               const Write& write) {
    std::vector<unsigned char> bytes;
    oiio::Filesystem::IOVecOutput memory(bytes);
    const std::unique_ptr<oiio::ImageOutput> output = oiio::ImageOutput::create(name, &memory);
    if (!output) return encode_failed(name, oiio::geterror());
    output->set_ioproxy(&memory);
    if (!output->open(name, spec) || !write(*output) || !output->close()) {
        return encode_failed(name, output->geterror());
    }
    const auto* first = reinterpret_cast<const std::byte*>(bytes.data());
    return std::vector<std::byte>(first, first + bytes.size());
}

Result<void> check_size(std::uint32_t width, std::uint32_t height, std::uint32_t side_max,
                        std::uint64_t bytes_max) {
    if (width <= side_max && height <= side_max && std::uint64_t{width} * height * 4 <= bytes_max)
        return {};
    return fail(
        ErrorCode::limit_exceeded,
        fmt::format("the picture is {} x {} pixels; at most {} a side and {} MiB decoded are "
                    "allowed",
                    width, height, side_max, bytes_max >> 20));
}

#ifdef RAYNEST_WEBP
/// Decodes a WebP with straight alpha, so that each pixel has its colour, however transparent.
/// Returns nothing for an animation: OpenImageIO has its first frame.
std::optional<Result<ImageDescription>> decode_webp(std::span<const std::byte> file,
                                                    std::uint32_t side_max,
                                                    std::uint64_t bytes_max) {
    const auto* const data = reinterpret_cast<const std::uint8_t*>(file.data());
    WebPBitstreamFeatures features{};
    if (WebPGetFeatures(data, file.size(), &features) != VP8_STATUS_OK || features.width <= 0 ||
        features.height <= 0)
        return decode_failed(0, "the picture's header cannot be read");
    if (features.has_animation != 0) return std::nullopt;
    const auto width = static_cast<std::uint32_t>(features.width);
    const auto height = static_cast<std::uint32_t>(features.height);
    if (auto fits = check_size(width, height, side_max, bytes_max); !fits)
        return tl::unexpected<Error>(fits.error());
    std::vector<std::uint8_t> rgba(std::size_t{width} * height * 4);
    if (WebPDecodeRGBAInto(data, file.size(), rgba.data(), rgba.size(), features.width * 4) ==
        nullptr)
        return decode_failed(rgba.size() * 2, "the picture is damaged or cut short");
    return ImageDescription{width, height, std::move(rgba)};
}
#endif

Result<ImageDescription> decode(std::span<const std::byte> file, std::uint32_t side_max,
                                std::uint64_t bytes_max) try {
    configure_once();
    const std::string name = plugin_name(file);
    if (name.empty()) {
        return fail(ErrorCode::scene_unsupported, "the picture is not a PNG, JPEG or WebP file");
    }
#ifdef RAYNEST_WEBP
    if (name == "memory.webp")
        if (auto decoded = decode_webp(file, side_max, bytes_max)) return std::move(*decoded);
#endif
    // libjpeg fills missing data with grey, and reports success after a warning. With an end of its
    // own a picture whose data are all there has no warning, and one that was cut has.
    std::vector<std::byte> ended;
    if (name == "memory.jpg" && !has_jpeg_end(file)) {
        ended.assign(file.begin(), file.end());
        ended.insert(ended.end(), {std::byte{0xFF}, std::byte{0xD9}});
        file = ended;
    }

    // Straight alpha: an associated colour would darken the edge of every leaf.
    oiio::Filesystem::IOMemReader memory(const_cast<std::byte*>(file.data()), file.size());
    const std::unique_ptr<oiio::ImageInput> input =
        oiio::ImageInput::create(name, false, nullptr, &memory);
    oiio::ImageSpec spec;
    oiio::ImageSpec config;
    config["oiio:UnassociatedAlpha"] = 1;
    if (!input || !input->set_ioproxy(&memory) || !input->open(name, spec, config)) {
        return decode_failed(0, "the picture's header cannot be read");
    }

    if (spec.width <= 0 || spec.height <= 0 || spec.depth > 1 || spec.nchannels < 1 ||
        spec.nchannels > 4) {
        return fail(ErrorCode::scene_invalid, "the picture's header is invalid");
    }
    const auto width = static_cast<std::uint32_t>(spec.width);
    const auto height = static_cast<std::uint32_t>(spec.height);
    const std::uint64_t count = std::uint64_t{width} * height;
    if (auto fits = check_size(width, height, side_max, bytes_max); !fits)
        return tl::unexpected<Error>(fits.error());

    const auto channels = static_cast<std::size_t>(spec.nchannels);
    std::vector<std::uint8_t> pixels(count * channels);
    if (!input->read_image(0, 0, 0, spec.nchannels, oiio::TypeDesc::UINT8, pixels.data())) {
        static_cast<void>(input->geterror());
        return decode_failed(count * 8, "the picture is damaged or cut short");
    }
    if (!ended.empty() && input->has_error()) {
        static_cast<void>(input->geterror());
        return fail(ErrorCode::scene_invalid, "the JPEG picture is cut short");
    }
    if (channels != 4) return ImageDescription{width, height, to_rgba(pixels, count, channels)};
    if (name == "memory.webp") divide_by_alpha(pixels);
    return ImageDescription{width, height, std::move(pixels)};
} catch (const std::bad_alloc&) {
    return fail(ErrorCode::out_of_memory, no_memory_to_decode);
} catch (const std::system_error&) {
    // A thread could not allocate its stack.
    return fail(ErrorCode::out_of_memory, no_memory_to_decode);
} catch (const std::exception& error) {
    return fail(ErrorCode::scene_invalid, fmt::format("the picture was refused: {}", error.what()));
}

Result<std::vector<std::byte>> encode_rgba(std::uint32_t width, std::uint32_t height,
                                           std::span<const std::uint8_t> rgba,
                                           std::span<const Attribute> attributes) try {
    if (rgba.size() != std::size_t{width} * height * 4 || rgba.empty()) {
        return fail(ErrorCode::internal, "encode_png: the pixels do not fill the picture");
    }
    configure_once();
    oiio::ImageSpec spec(static_cast<int>(width), static_cast<int>(height), 4,
                         oiio::TypeDesc::UINT8);
    spec.alpha_channel = 3;
    spec["oiio:UnassociatedAlpha"] = 1;
    spec["oiio:ColorSpace"] = "sRGB";
    spec["png:compressionLevel"] = 4;
    for (const Attribute& attribute : attributes) spec[attribute.name] = attribute.value;
    return write_to_memory("memory.png", spec, [&](oiio::ImageOutput& output) {
        return output.write_image(oiio::TypeDesc::UINT8, rgba.data());
    });
} catch (const std::bad_alloc&) {
    return no_memory_to_encode();
} catch (const std::exception& error) {
    return encode_failed("the PNG picture", error.what());
}

Result<std::vector<std::byte>> encode_channels(std::uint32_t width, std::uint32_t height,
                                               std::span<const Channel> channels,
                                               std::span<const Attribute> attributes) try {
    const std::size_t count = std::size_t{width} * height;
    if (count == 0 || channels.empty()) {
        return fail(ErrorCode::internal, "encode_exr: there is nothing to encode");
    }
    configure_once();
    oiio::ImageSpec spec(static_cast<int>(width), static_cast<int>(height),
                         static_cast<int>(channels.size()), oiio::TypeDesc::FLOAT);
    spec.channelnames.clear();
    spec["compression"] = "zip";
    // Set the date: otherwise the library writes the time of day, and equal requests give unequal
    // bytes.
    spec["DateTime"] = "1970:01:01 00:00:00";

    for (const Attribute& attribute : attributes) spec[attribute.name] = attribute.value;

    for (const Channel& channel : channels) {
        const bool is_float = !channel.f32.empty();
        if ((is_float ? channel.f32.size() : channel.u32.size()) != count) {
            return fail(ErrorCode::internal, "encode_exr: a channel does not fill the picture");
        }
        spec.channelnames.emplace_back(channel.name);
        spec.channelformats.emplace_back(is_float ? oiio::TypeDesc::FLOAT : oiio::TypeDesc::UINT);
    }
    return write_to_memory("memory.exr", spec, [&](oiio::ImageOutput& output) {
        // Every channel is 32 bits wide, so floats and counts interleave as plain words: a block
        // of rows at a time, because a film has 20 channels.
        std::vector<std::uint32_t> words(std::size_t{exr_block_rows} * width * channels.size());
        for (std::uint32_t row = 0; row < height; row += exr_block_rows) {
            const std::uint32_t rows = std::min(exr_block_rows, height - row);
            const std::size_t first = std::size_t{row} * width;
            for (std::size_t c = 0; c < channels.size(); ++c) {
                const Channel& channel = channels[c];
                for (std::size_t i = 0; i < std::size_t{rows} * width; ++i)
                    words[i * channels.size() + c] =
                        channel.f32.empty() ? channel.u32[first + i]
                                            : std::bit_cast<std::uint32_t>(channel.f32[first + i]);
            }
            if (!output.write_scanlines(static_cast<int>(row), static_cast<int>(row + rows), 0,
                                        oiio::TypeDesc::UNKNOWN, words.data()))
                return false;
        }
        return true;
    });
} catch (const std::bad_alloc&) {
    return no_memory_to_encode();
} catch (const std::exception& error) {
    return encode_failed("the EXR picture", error.what());
}

Result<std::vector<std::vector<std::uint32_t>>> decode_channels(std::span<const std::byte> file,
                                                                const ExrHeader& header) try {
    configure_once();
    const auto [width, height] = std::pair(header.width, header.height);
    const std::vector<ChannelType>& channels = header.channels;
    const std::uint64_t count = std::uint64_t{width} * height;
    oiio::Filesystem::IOMemReader memory(const_cast<std::byte*>(file.data()), file.size());
    const std::unique_ptr<oiio::ImageInput> input =
        oiio::ImageInput::create("memory.exr", false, nullptr, &memory);
    oiio::ImageSpec spec;
    if (!input || !input->set_ioproxy(&memory) || !input->open("memory.exr", spec))
        return decode_failed(0, "the EXR's header cannot be read");
    if (spec.width != static_cast<int>(width) || spec.height != static_cast<int>(height) ||
        spec.nchannels != static_cast<int>(channels.size()) || spec.tile_width != 0)
        return fail(ErrorCode::scene_invalid, "the EXR's header is invalid");

    // The library has an order of channels of its own.
    std::vector<std::size_t> plane_of(channels.size());
    for (std::size_t c = 0; c < channels.size(); ++c) {
        const auto named = std::ranges::find(spec.channelnames, channels[c].name);
        if (named == spec.channelnames.end())
            return fail(ErrorCode::scene_invalid, "the EXR's header is invalid");
        plane_of[static_cast<std::size_t>(named - spec.channelnames.begin())] = c;
    }
    std::vector<std::vector<std::uint32_t>> planes(channels.size(),
                                                   std::vector<std::uint32_t>(count));
    std::vector<std::uint32_t> words(std::size_t{exr_block_rows} * width * channels.size());
    for (std::uint32_t row = 0; row < height; row += exr_block_rows) {
        const std::uint32_t rows = std::min(exr_block_rows, height - row);
        if (!input->read_scanlines(0, 0, static_cast<int>(row), static_cast<int>(row + rows), 0, 0,
                                   spec.nchannels, oiio::TypeDesc::UNKNOWN, words.data())) {
            static_cast<void>(input->geterror());
            return decode_failed(words.size() * 4, "the EXR is damaged or cut short");
        }
        for (std::size_t c = 0; c < channels.size(); ++c)
            for (std::size_t i = 0; i < std::size_t{rows} * width; ++i)
                planes[plane_of[c]][std::size_t{row} * width + i] = words[i * channels.size() + c];
    }
    return planes;
} catch (const std::bad_alloc&) {
    return fail(ErrorCode::out_of_memory, no_memory_to_decode);
} catch (const std::system_error&) {
    return fail(ErrorCode::out_of_memory, no_memory_to_decode);
} catch (const std::exception& error) {
    return fail(ErrorCode::scene_invalid, fmt::format("the EXR was refused: {}", error.what()));
}

Result<LightPicture> decode_light(std::span<const std::byte> file, std::uint32_t side_max,
                                  std::uint64_t bytes_max) try {
    configure_once();
    const bool is_exr = starts_with(file, "\x76\x2f\x31\x01");
    if (!is_exr && !starts_with(file, "#?RADIANCE") && !starts_with(file, "#?RGBE"))
        return fail(ErrorCode::scene_unsupported, "the environment is neither an EXR nor an HDR");
    const char* const name = is_exr ? "memory.exr" : "memory.hdr";
    oiio::Filesystem::IOMemReader memory(const_cast<std::byte*>(file.data()), file.size());
    const std::unique_ptr<oiio::ImageInput> input =
        oiio::ImageInput::create(name, false, nullptr, &memory);
    oiio::ImageSpec spec;
    if (!input || !input->set_ioproxy(&memory) || !input->open(name, spec))
        return decode_failed(0, "the environment's header cannot be read");
    if (spec.width <= 0 || spec.height <= 0 || spec.depth > 1 || spec.nchannels < 1)
        return fail(ErrorCode::scene_invalid, "the environment's header is invalid");
    LightPicture picture;
    picture.width = static_cast<std::uint32_t>(spec.width);
    picture.height = static_cast<std::uint32_t>(spec.height);
    const std::uint64_t count = std::uint64_t{picture.width} * picture.height;
    const std::uint64_t needed =
        count * (sizeof(float) * static_cast<std::uint64_t>(spec.nchannels));
    if (picture.width > side_max || picture.height > side_max || spec.nchannels > 64 ||
        needed > bytes_max)
        return fail(
            ErrorCode::limit_exceeded,
            fmt::format("the environment is {} x {} pixels of {} channels; at most {} a "
                        "side and {} MiB decoded are allowed",
                        picture.width, picture.height, spec.nchannels, side_max, bytes_max >> 20));
    std::array<std::size_t, 3> channels{};
    for (std::size_t c = 0; c < 3; ++c) {
        constexpr std::array<const char*, 3> colours = {"R", "G", "B"};
        auto named = std::ranges::find(spec.channelnames, colours[c]);
        if (named == spec.channelnames.end()) named = std::ranges::find(spec.channelnames, "Y");
        if (named == spec.channelnames.end())
            return fail(ErrorCode::scene_invalid,
                        "the environment has no channels R, G and B: save it in RGB");
        channels[c] = static_cast<std::size_t>(named - spec.channelnames.begin());
    }
    const auto stride = static_cast<std::size_t>(spec.nchannels);
    std::vector<float> values(count * stride);
    if (!input->read_image(0, 0, 0, spec.nchannels, oiio::TypeDesc::FLOAT, values.data())) {
        static_cast<void>(input->geterror());
        return decode_failed(needed, "the environment is damaged or cut short");
    }
    picture.rgb.resize(count);
    for (std::size_t i = 0; i < count; ++i) {
        const auto value = [&](std::size_t c) { return values[i * stride + channels[c]]; };
        const Vec3 pixel(value(0), value(1), value(2));
        // One infinite pixel would outshine all others. A comparison with NaN is false.
        if (glm::all(glm::lessThanEqual(glm::abs(pixel), Vec3(light_radiance_max))))
            picture.rgb[i] = glm::max(pixel, Vec3(0));
        else
            ++picture.left_out;
    }
    return picture;
} catch (const std::bad_alloc&) {
    return fail(ErrorCode::out_of_memory, no_memory_to_decode);
} catch (const std::system_error&) {
    return fail(ErrorCode::out_of_memory, no_memory_to_decode);
} catch (const std::exception& error) {
    return fail(ErrorCode::scene_invalid,
                fmt::format("the environment was refused: {}", error.what()));
}

}  // namespace
}  // namespace raynest

extern "C" [[gnu::visibility("default")]] raynest::ImageModule raynest_images() noexcept {
    return {raynest::decode, raynest::encode_rgba, raynest::encode_channels,
            raynest::decode_channels, raynest::decode_light};
}
