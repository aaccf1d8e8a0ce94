#include "engine/assets/sandbox/import_wire.h"

#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>

namespace raynest::wire {
namespace {

constexpr std::uint64_t request_magic = 0x31545345'554E5952ULL;
constexpr std::uint64_t result_magic = 0x31544C53'554E5952ULL;
constexpr std::uint32_t files_max = 65536;
constexpr std::uint32_t masks_max = 65536;
constexpr std::uint32_t text_bytes_max = 65536;
constexpr std::uint32_t status_done = 0;

struct RequestHeader {
    std::uint64_t magic = request_magic;
    ImportLimits limits;
    Work work = Work::scene;
    std::int32_t parent = 0;
    std::uint32_t source_bytes = 0;
    std::uint32_t primitive_bytes = 0;
    std::uint32_t variant_bytes = 0;
    std::uint32_t file_count = 0;
    std::uint32_t mask_count = 0;
    BuildQuality build = BuildQuality::medium;
    WorldPoint origin{};
    FileOptions options{};
};
struct FileHeader {
    std::uint64_t bytes = 0;
    std::uint64_t name_bytes = 0;
};
struct ResultHeader {
    std::uint64_t magic = result_magic;
    std::uint32_t status = status_done;  ///< or an ErrorCode
    std::uint32_t words = 0;             ///< 32-bit words for each pixel of a picture
    std::uint64_t bytes = 0;             ///< size of the arena, picture or message that follows
    double build_seconds = 0;
    std::uint32_t width = 0, height = 0;  ///< a picture's size
    std::uint64_t left_out = 0;           ///< LightPicture::left_out
};

Result<void> read_all(int fd, void* bytes, std::size_t size, off_t offset) {
    auto* at = static_cast<char*>(bytes);
    while (size != 0) {
        const ssize_t got = ::pread(fd, at, std::min(size, std::size_t{1} << 30), offset);
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0)
            return fail(ErrorCode::internal, "the import process wrote an incomplete result");
        at += got;
        offset += got;
        size -= static_cast<std::size_t>(got);
    }
    return {};
}

/// Returns the next bytes of a message, or null if it has fewer.
class Cursor {
public:
    explicit Cursor(std::span<const std::byte> bytes) : rest_(bytes) {}
    const std::byte* take(std::uint64_t size) {
        if (size > rest_.size()) return nullptr;
        const std::byte* at = rest_.data();
        rest_ = rest_.subspan(size);
        return at;
    }

private:
    std::span<const std::byte> rest_;
};

Result<void> write_parts(int fd, const ResultHeader& header, std::span<const std::byte> payload) {
    auto done = write_all(fd, &header, sizeof header);
    if (done) done = write_all(fd, payload.data(), payload.size());
    return done;
}

Result<void> write_error(int fd, const Error& error) {
    ResultHeader header;
    header.status = static_cast<std::uint32_t>(error.code);
    auto payload = std::as_bytes(std::span(error.message));
    payload = payload.first(std::min<std::size_t>(payload.size(), text_bytes_max));
    header.bytes = payload.size();
    return write_parts(fd, header, payload);
}

tl::unexpected<Error> damaged_result() {
    return fail(ErrorCode::internal, "the import process wrote an incomplete result");
}

/// Reads a header and checks the size of what follows. Fails with the child's error, if it has one.
Result<ResultHeader> read_header(int fd, std::uint64_t bytes_max) {
    ResultHeader header;
    if (auto done = read_all(fd, &header, sizeof header, 0); !done) return damaged_result();
    struct stat status = {};
    const bool is_done = header.status == status_done;
    if (header.magic != result_magic || ::fstat(fd, &status) != 0 ||
        header.bytes > (is_done ? bytes_max : text_bytes_max) ||
        static_cast<std::uint64_t>(status.st_size) != sizeof header + header.bytes)
        return damaged_result();
    if (is_done) return header;
    if (header.status > static_cast<std::uint32_t>(last_error_code)) return damaged_result();
    std::string message(header.bytes, ' ');
    if (auto done = read_all(fd, message.data(), message.size(), sizeof header); !done)
        return damaged_result();
    for (char& c : message) {
        if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = ' ';
    }
    return fail(static_cast<ErrorCode>(header.status), std::move(message));
}

ResultHeader picture_header(std::uint32_t width, std::uint32_t height, std::size_t words) {
    ResultHeader header;
    header.width = width;
    header.height = height;
    header.words = static_cast<std::uint32_t>(words);
    header.bytes = std::uint64_t{width} * height * words * sizeof(std::uint32_t);
    return header;
}

/// Reads the header of a picture and checks its sizes against image_side_max and image_bytes_max.
Result<ResultHeader> read_picture_header(int fd, const ImportLimits& limits, std::size_t words) {
    auto header = read_header(fd, limits.image_bytes_max);
    if (!header) return header;
    if (header->width == 0 || header->height == 0 || header->width > limits.image_side_max ||
        header->height > limits.image_side_max || header->words != words ||
        header->bytes != picture_header(header->width, header->height, words).bytes)
        return damaged_result();
    return header;
}

}  // namespace

Result<void> write_request(int fd, Work work, const ImportRequest& request,
                           const ImportLimits& limits) {
    RequestHeader header;
    std::memset(static_cast<void*>(&header), 0, sizeof header);
    header.magic = request_magic;
    header.limits = limits;
    header.work = work;
    header.parent = ::getpid();
    header.source_bytes = static_cast<std::uint32_t>(request.source.size());
    header.primitive_bytes = static_cast<std::uint32_t>(request.primitive.size());
    header.variant_bytes = static_cast<std::uint32_t>(request.variant.size());
    header.build = request.build;
    header.origin = request.origin;
    header.options = request.options;
    header.file_count = static_cast<std::uint32_t>(request.files.size());
    header.mask_count = static_cast<std::uint32_t>(request.masks.size());
    if (request.source.size() > text_bytes_max || request.primitive.size() > text_bytes_max ||
        request.variant.size() > text_bytes_max || request.files.size() > files_max ||
        request.masks.size() > masks_max) {
        return fail(ErrorCode::limit_exceeded, "a scene may have at most 65536 files");
    }
    auto done = write_all(fd, &header, sizeof header);
    if (done) done = write_all(fd, request.source.data(), request.source.size());
    if (done) done = write_all(fd, request.primitive.data(), request.primitive.size());
    if (done) done = write_all(fd, request.variant.data(), request.variant.size());
    for (const std::string& mask : request.masks) {
        const std::uint64_t bytes = mask.size();
        if (done) done = write_all(fd, &bytes, sizeof bytes);
        if (done) done = write_all(fd, mask.data(), mask.size());
    }
    for (const NamedBytes& file : request.files) {
        const FileHeader file_header{file.bytes.size(), file.name.size()};
        if (done) done = write_all(fd, &file_header, sizeof file_header);
        if (done) done = write_all(fd, file.name.data(), file.name.size());
        if (done) done = write_all(fd, file.bytes.data(), file.bytes.size());
    }
    return done;
}

Result<Message> parse_request(std::span<const std::byte> bytes) {
    const auto damaged = fail(ErrorCode::internal, "the import request is damaged");
    Cursor cursor(bytes);
    RequestHeader header;
    const std::byte* at = cursor.take(sizeof header);
    if (at == nullptr) return damaged;
    std::memcpy(static_cast<void*>(&header), at, sizeof header);
    if (header.magic != request_magic || header.file_count > files_max ||
        header.mask_count > masks_max || header.build > BuildQuality::high ||
        header.work > Work::exr) {
        return damaged;
    }
    Message message;
    message.work = header.work;
    message.limits = header.limits;
    message.parent = header.parent;
    message.request.build = header.build;
    message.request.origin = header.origin;
    message.request.options = header.options;
    const auto take_text = [&](std::uint64_t size, std::string& text) {
        const std::byte* from = size > text_bytes_max ? nullptr : cursor.take(size);
        if (from != nullptr) text.assign(reinterpret_cast<const char*>(from), size);
        return from != nullptr;
    };
    if (!take_text(header.source_bytes, message.request.source) ||
        !take_text(header.primitive_bytes, message.request.primitive) ||
        !take_text(header.variant_bytes, message.request.variant)) {
        return damaged;
    }
    for (std::uint32_t i = 0; i < header.mask_count; ++i) {
        std::uint64_t size = 0;
        at = cursor.take(sizeof size);
        if (at == nullptr) return damaged;
        std::memcpy(&size, at, sizeof size);
        if (!take_text(size, message.request.masks.emplace_back())) return damaged;
    }
    for (std::uint32_t i = 0; i < header.file_count; ++i) {
        FileHeader file_header;
        at = cursor.take(sizeof file_header);
        if (at == nullptr) return damaged;
        std::memcpy(&file_header, at, sizeof file_header);
        NamedBytes file;
        if (!take_text(file_header.name_bytes, file.name)) return damaged;
        at = cursor.take(file_header.bytes);
        if (at == nullptr) return damaged;
        file.bytes = {at, file_header.bytes};
        message.request.files.push_back(std::move(file));
    }
    return message;
}

Result<void> write_result(int fd, const Result<BuiltArena>& result) {
    if (!result) return write_error(fd, result.error());
    ResultHeader header;
    header.bytes = result->arena.size();
    header.build_seconds = result->build_seconds;
    return write_parts(fd, header, {result->arena.data(), result->arena.size()});
}

Result<void> write_result(int fd, const Result<LightPicture>& result) {
    if (!result) return write_error(fd, result.error());
    const auto payload = std::as_bytes(std::span(result->rgb));
    ResultHeader header = picture_header(result->width, result->height, 3);
    header.left_out = result->left_out;
    return write_parts(fd, header, payload);
}

Result<void> write_result(int fd, const Result<ExrPlanes>& result) {
    if (!result) return write_error(fd, result.error());
    const ResultHeader header =
        picture_header(result->width, result->height, result->planes.size());
    auto done = write_all(fd, &header, sizeof header);
    for (const std::vector<std::uint32_t>& plane : result->planes)
        if (done) done = write_all(fd, plane.data(), plane.size() * sizeof plane[0]);
    return done;
}

Result<std::shared_ptr<const Snapshot>> read_result(int fd, std::uint64_t scene_bytes_max) {
    const auto header = read_header(fd, scene_bytes_max);
    if (!header) return tl::unexpected<Error>(header.error());
    if (!(header->build_seconds >= 0) || !std::isfinite(header->build_seconds))
        return damaged_result();
    Arena arena(header->bytes);
    if (auto done = read_all(fd, arena.data(), header->bytes, sizeof *header); !done)
        return damaged_result();
    return Snapshot::open({std::move(arena), header->build_seconds});
}

Result<LightPicture> read_light(int fd, const ImportLimits& limits) {
    const auto header = read_picture_header(fd, limits, 3);
    if (!header) return tl::unexpected<Error>(header.error());
    const std::uint64_t pixels = std::uint64_t{header->width} * header->height;
    if (header->left_out > pixels) return damaged_result();
    LightPicture picture{header->width, header->height, std::vector<Vec3>(pixels),
                         static_cast<std::uint32_t>(header->left_out)};
    if (auto done = read_all(fd, picture.rgb.data(), header->bytes, sizeof *header); !done)
        return damaged_result();
    // The decoder promises this; a child that an attack has taken over does not.
    for (Vec3& colour : picture.rgb)
        for (int c = 0; c < 3; ++c)
            if (!(colour[c] >= 0 && colour[c] <= light_radiance_max)) return damaged_result();
    return picture;
}

Result<ExrPlanes> read_planes(int fd, std::uint32_t width, std::uint32_t height,
                              std::size_t planes) {
    ImportLimits limits;
    limits.image_side_max = std::max(width, height);
    limits.image_bytes_max = picture_header(width, height, planes).bytes;
    const auto header = read_picture_header(fd, limits, planes);
    if (!header) return tl::unexpected<Error>(header.error());
    if (header->width != width || header->height != height) return damaged_result();
    ExrPlanes picture{width, height, {}};
    off_t at = sizeof *header;
    for (std::size_t i = 0; i < planes; ++i) {
        auto& plane = picture.planes.emplace_back(std::size_t{width} * height);
        const std::size_t bytes = plane.size() * sizeof plane[0];
        if (auto done = read_all(fd, plane.data(), bytes, at); !done) return damaged_result();
        at += static_cast<off_t>(bytes);
    }
    return picture;
}

}  // namespace raynest::wire
