// The only file that includes libtiff: a module of its own (geotiff.h).
#include "engine/assets/formats/geotiff.h"

#include <fmt/format.h>
#include <tiffio.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstring>
#include <limits>
#include <memory>
#include <string>
#include <string_view>

namespace raynest {
namespace {

// Tags that libtiff does not know by name.
constexpr std::uint32_t pixel_scale_tag = 33550;
constexpr std::uint32_t tiepoint_tag = 33922;
constexpr std::uint32_t transformation_tag = 34264;
constexpr std::uint32_t geo_keys_tag = 34735;
constexpr std::uint32_t metadata_tag = 42112;
constexpr std::uint32_t no_data_tag = 42113;

// GeoTIFF 1.1, section 7.4.
constexpr std::uint16_t model_type_key = 1024;   // 1: a map, 2: degrees, 3: from the Earth's centre
constexpr std::uint16_t raster_type_key = 1025;  // value 2: a number is a point, not an area
constexpr std::uint16_t geographic_key = 2048;
constexpr std::uint16_t linear_unit_key = 3076;
constexpr std::uint16_t height_unit_key = 4099;

/// A strip or tile is read at once.
constexpr std::uint64_t part_bytes_max = 256U << 20;

tl::unexpected<Error> refuse(std::string why) {
    return fail(ErrorCode::scene_invalid, std::move(why));
}

/// The file as libtiff reads it, from memory.
struct Source {
    std::span<const std::byte> bytes;
    std::uint64_t at = 0;

    static tmsize_t read(thandle_t handle, void* out, tmsize_t size) {
        auto& source = *static_cast<Source*>(handle);
        if (source.at >= source.bytes.size() || size <= 0) return 0;
        const std::size_t count =
            std::min(static_cast<std::size_t>(size), source.bytes.size() - source.at);
        std::memcpy(out, source.bytes.data() + source.at, count);
        source.at += count;
        return static_cast<tmsize_t>(count);
    }
    static tmsize_t write(thandle_t, void*, tmsize_t) { return 0; }
    static toff_t seek(thandle_t handle, toff_t offset, int from) {
        auto& source = *static_cast<Source*>(handle);
        source.at = from == SEEK_SET   ? offset
                    : from == SEEK_CUR ? source.at + offset
                                       : source.bytes.size() + offset;
        return source.at;
    }
    static int close(thandle_t) { return 0; }
    static toff_t size(thandle_t handle) { return static_cast<Source*>(handle)->bytes.size(); }
};

/// The last complaint of libtiff; one thread of an import reads one file.
thread_local std::string complaint;

void keep_complaint(const char*, const char* format, va_list arguments) {
    std::array<char, 200> text{};
    std::vsnprintf(text.data(), text.size(), format, arguments);
    complaint = text.data();
    std::ranges::replace_if(
        complaint, [](char c) { return c < ' ' || c > '~'; }, ' ');
}

using Tiff = std::unique_ptr<TIFF, decltype(&TIFFClose)>;

/// The numbers of a tag that libtiff does not know; empty where it is absent. Fails where it is there
/// and cannot be read, as in a file that was cut short: libtiff leaves it out without an error.
template <class T>
Result<std::span<const T>> numbers_of(TIFF* tiff, std::uint32_t tag, TIFFDataType type) {
    const TIFFField* const field = TIFFFieldWithTag(tiff, tag);
    if (field == nullptr) return {};
    std::uint32_t count = 0;
    const T* values = nullptr;
    if (TIFFFieldDataType(field) != type || TIFFFieldReadCount(field) != TIFF_VARIABLE2 ||
        TIFFGetField(tiff, tag, &count, &values) != 1 || values == nullptr)
        return refuse(fmt::format("is damaged or cut short: its tag {} cannot be read", tag));
    return std::span<const T>(values, count);
}

/// The value of a key that lies in the directory itself; 0 where it is absent.
std::uint16_t geo_key(std::span<const std::uint16_t> keys, std::uint16_t wanted) {
    for (std::size_t i = 4; i + 4 <= keys.size(); i += 4)
        if (keys[i] == wanted && keys[i + 1] == 0) return keys[i + 3];
    return 0;
}

Result<std::optional<std::array<double, 6>>> map_of(TIFF* tiff, bool is_point) {
    std::array<double, 6> map{};
    const auto matrix_tag = numbers_of<double>(tiff, transformation_tag, TIFF_DOUBLE);
    const auto scale_tag = numbers_of<double>(tiff, pixel_scale_tag, TIFF_DOUBLE);
    const auto tie_tag = numbers_of<double>(tiff, tiepoint_tag, TIFF_DOUBLE);
    for (const auto* tag : {&matrix_tag, &scale_tag, &tie_tag})
        if (!*tag) return tl::unexpected(tag->error());
    const std::span<const double> matrix = *matrix_tag, scale = *scale_tag, tie = *tie_tag;
    if (matrix.size() >= 16) {
        map = {matrix[3], matrix[0], matrix[1], matrix[7], matrix[4], matrix[5]};
    } else if (scale.size() >= 2 && tie.size() >= 6) {
        map = {tie[3] - tie[0] * scale[0], scale[0], 0, tie[4] + tie[1] * scale[1], 0, -scale[1]};
    } else {
        return std::nullopt;
    }
    if (!is_point) {  // the height is that of the area's middle
        map[0] += 0.5 * (map[1] + map[2]);
        map[3] += 0.5 * (map[4] + map[5]);
    }
    const double area = map[1] * map[5] - map[2] * map[4];
    if (!std::isfinite(area) || area == 0)
        return refuse("places its heights on a line of the map, or nowhere");
    return map;
}

/// How a number of the file is stored.
struct Sample {
    std::uint16_t bits = 1;
    std::uint16_t format = SAMPLEFORMAT_UINT;

    [[nodiscard]] std::size_t bytes() const { return bits / 8; }
    [[nodiscard]] bool is_float32() const { return format == SAMPLEFORMAT_IEEEFP && bits == 32; }
    [[nodiscard]] bool is_known() const {
        return format == SAMPLEFORMAT_IEEEFP
                   ? bits == 32 || bits == 64
                   : (format == SAMPLEFORMAT_UINT || format == SAMPLEFORMAT_INT) &&
                         (bits == 8 || bits == 16 || bits == 32);
    }
    [[nodiscard]] double at(const unsigned char* bytes) const {
        const auto as = [&]<class T>(T value) {
            std::memcpy(&value, bytes, sizeof value);
            return static_cast<double>(value);
        };
        if (format == SAMPLEFORMAT_IEEEFP) return bits == 32 ? as(0.0F) : as(0.0);
        if (format == SAMPLEFORMAT_INT)
            return bits == 8    ? as(std::int8_t{})
                   : bits == 16 ? as(std::int16_t{})
                                : as(std::int32_t{});
        return bits == 8    ? as(std::uint8_t{})
               : bits == 16 ? as(std::uint16_t{})
                            : as(std::uint32_t{});
    }
};

/// A text of GDAL; empty where there is none.
Result<std::string_view> text_of(TIFF* tiff, std::uint32_t tag) {
    const auto text = numbers_of<char>(tiff, tag, TIFF_ASCII);
    if (!text) return tl::unexpected(text.error());
    const auto end = std::ranges::find(*text, '\0');
    return std::string_view(text->data(), static_cast<std::size_t>(end - text->begin()));
}

/// The number that stands for no height; NaN where there is none.
Result<double> no_data_of(TIFF* tiff) {
    auto text = text_of(tiff, no_data_tag);
    if (!text) return tl::unexpected(text.error());
    const std::string_view blank = " \t\r\n";
    text->remove_prefix(std::min(text->find_first_not_of(blank), text->size()));
    text->remove_suffix(text->size() - (text->find_last_not_of(blank) + 1));
    double value = std::numeric_limits<double>::quiet_NaN();
    if (text->empty()) return value;
    const char* const end = text->data() + text->size();
    const auto [next, error] = std::from_chars(text->data(), end, value);
    if (error != std::errc{} || next != end)
        return refuse(
            "says with something that is no number which heights are not known: set it "
            "anew, with gdal_edit.py -a_nodata");
    return value;
}

class Reader {
public:
    Reader(TIFF* tiff, HeightGrid& grid, Sample sample, double no_data)
        : tiff_(tiff),
          grid_(grid),
          sample_(sample),
          no_data_(no_data) {}

    Result<void> read() {
        const bool is_tiled = TIFFIsTiled(tiff_) != 0;
        std::uint32_t width = static_cast<std::uint32_t>(grid_.columns);
        std::uint32_t height = static_cast<std::uint32_t>(grid_.rows);
        if (is_tiled) {
            TIFFGetField(tiff_, TIFFTAG_TILEWIDTH, &width);
            TIFFGetField(tiff_, TIFFTAG_TILELENGTH, &height);
        } else {
            TIFFGetFieldDefaulted(tiff_, TIFFTAG_ROWSPERSTRIP, &height);
            height = std::min(height, static_cast<std::uint32_t>(grid_.rows));
        }
        const std::uint64_t bytes = is_tiled ? TIFFTileSize64(tiff_) : TIFFStripSize64(tiff_);
        if (width == 0 || height == 0 || bytes > part_bytes_max ||
            bytes < std::uint64_t{width} * sample_.bytes())
            return refuse(fmt::format("has {} of {} bytes; at most {} are read at once",
                                      is_tiled ? "tiles" : "strips", bytes, part_bytes_max));
        std::vector<unsigned char> part(bytes);
        std::uint32_t number = 0;
        for (std::uint64_t row = 0; row < grid_.rows; row += height) {
            for (std::uint64_t column = 0; column < grid_.columns; column += width, ++number) {
                if (is_left_out(number)) continue;
                const auto size = static_cast<tmsize_t>(bytes);
                const tmsize_t got = is_tiled
                                         ? TIFFReadEncodedTile(tiff_, number, part.data(), size)
                                         : TIFFReadEncodedStrip(tiff_, number, part.data(), size);
                const std::uint64_t rows = std::min<std::uint64_t>(height, grid_.rows - row);
                if (got < 0 || static_cast<std::uint64_t>(got) < rows * width * sample_.bytes())
                    return refuse("is damaged: " + (complaint.empty() ? "cut short" : complaint));
                take(part.data(), row, column, rows, width);
            }
        }
        return {};
    }

private:
    [[nodiscard]] bool is_left_out(std::uint32_t number) const {
        int failed = 0;
        return TIFFGetStrileOffsetWithErr(tiff_, number, &failed) == 0 && failed == 0 &&
               TIFFGetStrileByteCountWithErr(tiff_, number, &failed) == 0 && failed == 0;
    }
    void take(const unsigned char* part, std::uint64_t row, std::uint64_t column,
              std::uint64_t rows, std::uint64_t width) {
        const std::uint64_t columns = std::min(width, grid_.columns - column);
        for (std::uint64_t r = 0; r < rows; ++r) {
            double* const out = grid_.heights.data() + (row + r) * grid_.columns + column;
            const unsigned char* const in = part + r * width * sample_.bytes();
            for (std::uint64_t c = 0; c < columns; ++c) {
                const double value = sample_.at(in + c * sample_.bytes());
                // A no-data number is written as text, and may have lost digits of float32.
                const bool is_hole = value == no_data_ || !std::isfinite(value) ||
                                     (sample_.is_float32() &&
                                      static_cast<float>(value) == static_cast<float>(no_data_));
                out[c] = is_hole ? std::numeric_limits<double>::quiet_NaN() : value;
            }
        }
    }

    TIFF* tiff_;
    HeightGrid& grid_;
    Sample sample_;
    double no_data_;
};

Result<HeightGrid> decode(std::span<const std::byte> file, std::uint64_t heights_max) {
    TIFFSetErrorHandler(keep_complaint);
    TIFFSetWarningHandler(nullptr);
    complaint.clear();
    Source source{file};
    const Tiff tiff(TIFFClientOpen("heights", "rm", &source, Source::read, Source::write,
                                   Source::seek, Source::close, Source::size, nullptr, nullptr),
                    &TIFFClose);
    if (!tiff) return refuse("is no TIFF: " + (complaint.empty() ? "cut short" : complaint));
    std::uint32_t columns = 0, rows = 0;
    std::uint16_t bands = 1;
    Sample sample;
    TIFFGetField(tiff.get(), TIFFTAG_IMAGEWIDTH, &columns);
    TIFFGetField(tiff.get(), TIFFTAG_IMAGELENGTH, &rows);
    TIFFGetFieldDefaulted(tiff.get(), TIFFTAG_SAMPLESPERPIXEL, &bands);
    TIFFGetFieldDefaulted(tiff.get(), TIFFTAG_BITSPERSAMPLE, &sample.bits);
    TIFFGetFieldDefaulted(tiff.get(), TIFFTAG_SAMPLEFORMAT, &sample.format);
    if (bands != 1)
        return refuse(fmt::format(
            "has {} bands, and heights are one: pick it with gdal_translate -b 1", bands));
    if (!sample.is_known())
        return refuse(
            fmt::format("has numbers of {} bits in the TIFF's format {}: save it as "
                        "float32, with gdal_translate -ot Float32",
                        sample.bits, sample.format));
    if (columns < 2 || rows < 2) return refuse("is no grid of two rows and columns or more");
    if (std::uint64_t{columns} * rows > heights_max)
        return fail(
            ErrorCode::limit_exceeded,
            fmt::format("has {} x {} heights; at most {} are allowed", columns, rows, heights_max));
    HeightGrid grid;
    grid.columns = columns;
    grid.rows = rows;
    const auto key_tag = numbers_of<std::uint16_t>(tiff.get(), geo_keys_tag, TIFF_SHORT);
    const auto no_data = no_data_of(tiff.get());
    const auto metadata = text_of(tiff.get(), metadata_tag);
    if (!key_tag) return tl::unexpected(key_tag.error());
    if (!no_data) return tl::unexpected(no_data.error());
    if (!metadata) return tl::unexpected(metadata.error());
    for (const char* scaled : {"role=\"scale\"", "role=\"offset\""})
        if (metadata->find(scaled) != std::string_view::npos)
            return refuse(
                "has a scale or an offset for its numbers: apply them, with "
                "gdal_translate -unscale -ot Float32");
    const std::span<const std::uint16_t> keys = *key_tag;
    const std::uint16_t model = geo_key(keys, model_type_key);
    if (model == 3)
        return refuse(
            "counts from the middle of the Earth: bring it to a map in metres, with "
            "gdalwarp -t_srs");
    grid.is_in_degrees = model == 2 || (model == 0 && geo_key(keys, geographic_key) != 0);
    grid.unit = geo_key(keys, linear_unit_key);
    grid.height_unit = geo_key(keys, height_unit_key);
    auto map = map_of(tiff.get(), geo_key(keys, raster_type_key) == 2);
    if (!map) return tl::unexpected(map.error());
    grid.to_map = *map;
    // GDAL leaves out tiles of which no height is known, or else those that are 0 throughout.
    const auto no_data_text = text_of(tiff.get(), no_data_tag);
    const bool knows_holes = no_data_text && !no_data_text->empty();
    grid.heights.assign(std::size_t{columns} * rows,
                        knows_holes ? std::numeric_limits<double>::quiet_NaN() : 0);
    if (auto done = Reader(tiff.get(), grid, sample, *no_data).read(); !done)
        return tl::unexpected(done.error());
    return grid;
}

}  // namespace
}  // namespace raynest

extern "C" __attribute__((visibility("default"))) decltype(&raynest::decode_geotiff)
raynest_geotiff() noexcept {
    return &raynest::decode;
}
