// .npz: a ZIP archive of .npy files, and single grids of heights.
//
// zlib does the inflating. The archive is read here, by its central directory alone: Debian's
// libzip and minizip would only find two names.
#include "engine/assets/formats/formats.h"
#include "engine/assets/formats/npy_array.h"
#include "engine/assets/formats/number_at.h"
#include "engine/assets/input/messages.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <map>
#include <optional>

namespace raynest {
namespace {

using Bytes = std::span<const std::byte>;

struct Entry {
    std::uint16_t method = 0;
    std::uint32_t checksum = 0;  ///< CRC-32 of the unpacked bytes
    std::uint64_t packed_bytes = 0, bytes = 0, header_at = 0;
};
using Entries = std::map<std::string, Entry, std::less<>>;

constexpr std::size_t end_bytes = 22, entry_bytes = 46, local_bytes = 30;
constexpr std::size_t comment_bytes_max = 65535;
constexpr std::uint16_t stored = 0, deflated = 8;

tl::unexpected<Error> damaged(const char* why) {
    return fail(ErrorCode::scene_invalid, fmt::format("is no whole .npz: {}", why));
}

Result<Entries> read_directory(Bytes file) {
    std::optional<std::size_t> end;
    for (std::size_t back = end_bytes;
         back <= std::min(file.size(), end_bytes + comment_bytes_max) && !end; ++back)
        if (number_at<std::uint32_t>(file, file.size() - back) == 0x06054B50)
            end = file.size() - back;
    if (!end) return damaged("it has no directory; it is cut short");
    const auto count = number_at<std::uint16_t>(file, *end + 10);
    std::uint64_t at = number_at<std::uint32_t>(file, *end + 16);
    Entries entries;
    for (std::uint32_t i = 0; i < count; ++i) {
        if (at > *end || *end - at < entry_bytes ||
            number_at<std::uint32_t>(file, at) != 0x02014B50)
            return damaged("its directory is damaged, or over 4 GiB long");
        const auto name_bytes = number_at<std::uint16_t>(file, at + 28);
        const std::size_t more = std::size_t{name_bytes} + number_at<std::uint16_t>(file, at + 30) +
                                 number_at<std::uint16_t>(file, at + 32);
        if (*end - at - entry_bytes < more) return damaged("its directory is damaged");
        const std::string name(reinterpret_cast<const char*>(file.data()) + at + entry_bytes,
                               name_bytes);
        entries.emplace(
            name,
            Entry{number_at<std::uint16_t>(file, at + 10), number_at<std::uint32_t>(file, at + 16),
                  number_at<std::uint32_t>(file, at + 20), number_at<std::uint32_t>(file, at + 24),
                  number_at<std::uint32_t>(file, at + 42)});
        at += entry_bytes + more;
    }
    return entries;
}

/// Inflates to exactly `size` bytes. `size` is bounded by what deflate can do, so that a small file
/// cannot ask for much.
Result<std::vector<std::byte>> inflate_exactly(Bytes packed, std::uint64_t size) {
    constexpr std::uint64_t ratio_max = 1032;  // deflate's highest
    if (size > packed.size() * ratio_max + 64 || size > 0xFFFFFFFF || packed.size() > 0xFFFFFFFF)
        return damaged("an array is longer than its packed bytes can give");
    std::vector<std::byte> bytes(size);
    z_stream stream{};
    if (inflateInit2(&stream, -MAX_WBITS) != Z_OK)
        return fail(ErrorCode::out_of_memory, "zlib does not start");
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<std::byte*>(packed.data()));
    stream.avail_in = static_cast<uInt>(packed.size());
    stream.next_out = reinterpret_cast<Bytef*>(bytes.data());
    stream.avail_out = static_cast<uInt>(size);
    const int state = inflate(&stream, Z_FINISH);
    inflateEnd(&stream);
    if (state != Z_STREAM_END || stream.avail_out != 0)
        return damaged("an array does not unpack to its length");
    return bytes;
}

/// Opens arrays of an archive; `left` bounds their unpacked bytes together.
class Archive {
public:
    Archive(Bytes file, Entries entries, const ImportLimits& limits)
        : file_(file),
          entries_(std::move(entries)),
          limits_(limits),
          left_(limits.file_bytes_max) {}

    /// Unpacks the first of the names that is there into `bytes`. It lies in `folder`, unless that
    /// is empty.
    Result<NpyArray> open(const std::string& folder, std::initializer_list<std::string_view> names,
                          std::vector<std::byte>& bytes) {
        const std::string before = folder.empty() ? "" : folder + '/';
        for (const std::string_view name : names) {
            const auto found = entries_.find(fmt::format("{}{}.npy", before, name));
            if (found == entries_.end()) continue;
            const Entry& entry = found->second;
            if (entry.bytes > left_)
                return fail(ErrorCode::limit_exceeded,
                            fmt::format("unpacks to over {} MiB", limits_.file_bytes_max >> 20));
            left_ -= entry.bytes;
            const auto packed = packed_bytes(entry);
            if (!packed) return tl::unexpected<Error>(packed.error());
            Bytes all = *packed;
            if (entry.method == deflated) {
                auto inflated = inflate_exactly(*packed, entry.bytes);
                if (!inflated) return tl::unexpected<Error>(inflated.error());
                bytes = std::move(*inflated);
                all = bytes;
            } else if (entry.method != stored) {
                return fail(
                    ErrorCode::scene_unsupported,
                    "is packed by other means than deflate: save it with numpy.savez_compressed");
            }
            if (crc32_z(0, reinterpret_cast<const Bytef*>(all.data()), all.size()) !=
                entry.checksum)
                return damaged("an array has another checksum than when it was saved");
            return parse_npy({std::string(name), all}, limits_);
        }
        std::string there;
        for (const auto& [name, entry] : entries_) {
            if (there.size() > 200) break;
            there += fmt::format("{}{}", there.empty() ? "" : ", ", one_line(name, 40));
        }
        return fail(
            ErrorCode::scene_invalid,
            fmt::format("has no array '{}{}': save it with numpy.savez(file, vertices=..., "
                        "faces=...); it has {}",
                        one_line(before, 60), *names.begin(), there.empty() ? "none" : there));
    }

private:
    Result<Bytes> packed_bytes(const Entry& entry) {
        if (entry.header_at > file_.size() || file_.size() - entry.header_at < local_bytes ||
            number_at<std::uint32_t>(file_, entry.header_at) != 0x04034B50)
            return damaged("an array lies outside the file");
        const std::uint64_t at = entry.header_at + local_bytes +
                                 number_at<std::uint16_t>(file_, entry.header_at + 26) +
                                 number_at<std::uint16_t>(file_, entry.header_at + 28);
        if (at > file_.size() || file_.size() - at < entry.packed_bytes)
            return damaged("an array ends beyond the file");
        return file_.subspan(at, entry.packed_bytes);
    }

    Bytes file_;
    Entries entries_;
    const ImportLimits& limits_;
    std::uint64_t left_;
};

bool is_rows_of_three(const NpyArray& array) {
    return array.shape.size() == 2 && array.shape[1] == 3;
}

}  // namespace

Result<FileContent> read_npz(const ImportRequest& request, const ImportLimits& limits) {
    const Bytes file = request.files.front().bytes;
    auto entries = read_directory(file);
    if (!entries) return tl::unexpected<Error>(entries.error());
    Archive archive(file, std::move(*entries), limits);
    std::vector<std::byte> vertex_bytes, face_bytes;
    const auto vertices = archive.open(request.mesh, {"vertices", "v"}, vertex_bytes);
    if (!vertices) return tl::unexpected<Error>(vertices.error());
    const auto faces = archive.open(request.mesh, {"faces", "f"}, face_bytes);
    if (!faces) return tl::unexpected<Error>(faces.error());
    if (!is_rows_of_three(*vertices)) return refuse_array("vertices", "must have shape (N, 3)");
    if (!is_rows_of_three(*faces) || faces->layout.kind == 'f')
        return refuse_array("faces", "must hold whole numbers in shape (M, 3)");
    FileContent content;
    content.is_float32 = vertices->layout.kind == 'f' && vertices->layout.item == 4;
    content.objects.push_back({{}, {FileGeometry{}}});
    FileGeometry& geometry = content.objects.back().geometries.back();
    geometry.positions.reserve(vertices->shape[0]);
    for (std::uint64_t row = 0; row < vertices->shape[0]; ++row)
        geometry.positions.emplace_back(vertices->at(row, 0), vertices->at(row, 1),
                                        vertices->at(row, 2));
    geometry.rest.indices.reserve(faces->count);
    for (std::uint64_t row = 0; row < faces->shape[0]; ++row) {
        for (std::uint64_t i = 0; i < 3; ++i) {
            const double corner = faces->at(row, i);
            if (!(corner >= 0 && corner < static_cast<double>(vertices->shape[0])))
                return refuse_array("faces",
                                    fmt::format("uses vertex {} of {} in row {}: they count from 0",
                                                corner, vertices->shape[0], row));
            geometry.rest.indices.push_back(static_cast<std::uint32_t>(corner));
        }
    }
    return content;
}

}  // namespace raynest
