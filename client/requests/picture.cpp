#include "client/requests/picture.h"

#include "client/files/files.h"
#include "client/files/npy.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <utility>

namespace raynest::client {
namespace {

constexpr int document_depth_max = 64;

// Bytes of an encoded pixel at most: of a heat map a channel of four bytes for every counter of every
// level, of a lit picture 20 channels, of any other an EXR of four floats. Python has the same.
constexpr std::uint64_t heat_pixel_bytes_max = 2048;
constexpr std::uint64_t lit_pixel_bytes_max = 80;
constexpr std::uint64_t pixel_bytes_max = 16;
constexpr std::uint64_t legend_bytes_max = 4ULL << 20;
constexpr std::uint64_t document_bytes_max = 64ULL << 20;
constexpr std::uint64_t answer_bytes_max = 4ULL << 30;

/// The room of a picture, or of a document that says its pixels or has its file as Base64.
template <class Request>
Room room_for(const Request& request, std::uint64_t pixel_bytes) {
    Room room{legend_bytes_max, pixel_bytes, request.width, request.height};
    if (request.tile_width != 0) room.width = request.tile_width, room.height = request.tile_height;
    const bool is_picture =
        request.encode == "raw" || request.encode == "png" || request.encode == "exr";
    if (is_picture)
        room.encode = request.encode;
    else
        room.bytes_max = document_bytes_max, room.pixel_bytes *= 2;
    return room;
}

/// Makes room for a payload, after checking that it fits.
Result<void> begin_payload(const wire::Payload& piece, const Room& room, ReceivedFile& picture) {
    picture.encode = protocol::text(piece.encode());
    picture.total = piece.total();
    picture.is_last = piece.last();
    picture.bytes.clear();
    picture.width = piece.width();
    picture.height = piece.height();
    const bool is_raw = room.pixel_bytes != 0 && picture.encode == "raw";
    // A part may come before the whole; each says its size.
    const bool has_size = room.width != 0 && !(is_raw && !picture.is_last);
    const std::uint64_t width = has_size ? room.width : piece.width();
    const std::uint64_t pixels = width * (has_size ? room.height : piece.height());
    if ((!room.encode.empty() && picture.encode != room.encode) ||
        picture.total > room.bytes_max + room.pixel_bytes * pixels ||
        (is_raw && (picture.total != 4 * pixels || width != piece.width())))
        return daemon_sent("another answer than was asked for, of " +
                           std::to_string(picture.total) + " bytes");
    return {};
}

/// Appends the bytes of a frame after checking that they are the next ones. Passes a whole picture
/// on, if a later one will replace it.
Result<void> take_piece(const protocol::Frame& frame, const Room& room, ReceivedFile& picture,
                        const PassConsumer& consume_pass) {
    const auto opened = open_sent<wire::Payload>(frame);
    if (!opened) return tl::unexpected<Failure>(opened.error());
    const wire::Payload& piece = *opened->table;
    const protocol::BlockView* data = protocol::find_block(opened->blocks, "data");
    if (picture.bytes.size() == picture.total && !picture.is_last)
        if (auto begun = begin_payload(piece, room, picture); !begun) return begun;
    if (data == nullptr || piece.offset() != picture.bytes.size() ||
        piece.total() != picture.total || data->bytes.size() > picture.total - piece.offset())
        return daemon_sent("pieces of a picture that do not fit together");
    picture.exposure = piece.exposure();
    picture.bytes.insert(picture.bytes.end(), data->bytes.begin(), data->bytes.end());
    const bool is_pass = !picture.is_last && picture.bytes.size() == picture.total;
    return is_pass && consume_pass ? consume_pass(picture) : Result<void>{};
}

/// Returns "tracing", or of a lit picture "16 samples, noise 3.1 %, 14 s left".
std::string stage_text(const wire::Progress& news) {
    std::string text(protocol::text(news.stage()));
    if (news.samples() != 0) text = std::to_string(news.samples()) + " samples";
    if (news.noise() > 0) {
        std::array<char, 32> noise{};
        std::snprintf(noise.data(), noise.size(), ", noise %.2g %%",
                      100 * static_cast<double>(news.noise()));
        text += noise.data();
    }
    if (news.left_ms() != 0)
        text += ", " + std::to_string((news.left_ms() + 999) / 1000) + " s left";
    return text;
}

}  // namespace

std::string encoding_of(const std::string& output) {
    const std::string ending = extension_of(output);
    if (output == standard_stream || ending.empty() || ending == ".html") return "png";
    return ending == ".npy" ? "raw" : ending.substr(std::min<std::size_t>(1, ending.size()));
}

Room document_room() {
    return {.bytes_max = document_bytes_max, .starts = false};
}

Room file_room() {
    return {.bytes_max = answer_bytes_max};
}

Room picture_room(bool is_heat_map) {
    return {legend_bytes_max, is_heat_map ? heat_pixel_bytes_max : lit_pixel_bytes_max};
}

Room room_of(const wire::RenderT& request) {
    const bool is_lit = request.encode == "exr" || request.encode == "linear";
    return room_for(request, is_lit ? lit_pixel_bytes_max : pixel_bytes_max);
}

Room room_of(const wire::HeatmapT& request) {
    const bool is_exr = request.encode.ends_with("exr");
    return room_for(request, is_exr ? heat_pixel_bytes_max : pixel_bytes_max);
}

Result<ReceivedFile> receive_file(Connection& connection, Progress& progress, const Room& room,
                                  ReceivedFile picture, const PassConsumer& consume_pass) {
    while (true) {
        const auto frame = connection.next();
        if (!frame) return tl::unexpected<Failure>(frame.error());
        if (auto taken = take_news(*frame, picture.outcome); !taken)
            return tl::unexpected<Failure>(taken.error());
        if (is<wire::Detached>(*frame)) return picture;
        if (is<wire::Done>(*frame)) {
            if (room.starts && !picture.outcome.has_started)
                return daemon_sent("the end of a request that had not started");
            if (picture.total == 0 || picture.bytes.size() != picture.total)
                return daemon_sent("the end of an answer before its last piece");
            return picture;
        }
        if (is<wire::Payload>(*frame)) {
            if (auto taken = take_piece(*frame, room, picture, consume_pass); !taken)
                return tl::unexpected<Failure>(taken.error());
        } else if (is<wire::Progress>(*frame)) {
            const auto news = open_sent<wire::Progress>(*frame);
            if (!news) return tl::unexpected<Failure>(news.error());
            progress.update((*news)->done(), (*news)->total(), stage_text(*news->table));
        }
    }
}

Result<std::uint64_t> receive_bytes(Connection& connection, Progress& progress, Outcome& outcome,
                                    const BytesConsumer& consume) {
    std::uint64_t received = 0;
    std::uint64_t total = 0;
    while (true) {
        const auto frame = connection.next();
        if (!frame) return tl::unexpected<Failure>(frame.error());
        if (auto taken = take_news(*frame, outcome); !taken)
            return tl::unexpected<Failure>(taken.error());
        if (is<wire::Done>(*frame)) {
            if (total == 0 || received != total)
                return daemon_sent("the end of an answer before its last piece");
            return total;
        }
        if (!is<wire::Payload>(*frame)) continue;
        const auto piece = open_sent<wire::Payload>(*frame);
        if (!piece) return tl::unexpected<Failure>(piece.error());
        const protocol::BlockView* data = protocol::find_block(piece->blocks, "data");
        if (received == 0) total = (*piece)->total();
        if (data == nullptr || (*piece)->offset() != received || (*piece)->total() != total ||
            data->bytes.size() > total - received)
            return daemon_sent("pieces of a file that do not fit together");
        if (auto consumed = consume(data->bytes); !consumed)
            return tl::unexpected<Failure>(consumed.error());
        received += data->bytes.size();
        progress.update(received, total, "downloading");
    }
}

Result<std::vector<std::byte>> npy_file(const ReceivedFile& picture, const char* dtype,
                                        std::vector<std::uint64_t> shape) {
    if (picture.bytes.size() != 4ULL * picture.width * picture.height)
        return daemon_sent("pixels of another number than the picture has");
    return format_npy({dtype, std::move(shape), picture.bytes});
}

Result<Json> read_json(const ReceivedFile& answer) {
    const auto* text = reinterpret_cast<const char*>(answer.bytes.data());
    // Deeper documents would exhaust the stack of whoever walks through them.
    bool is_deep = false;
    const auto look = [&](int depth, Json::parse_event_t, Json&) {
        is_deep = is_deep || depth > document_depth_max;
        return !is_deep;
    };
    Json json = Json::parse(text, text + answer.bytes.size(), look, false);
    if (is_deep || answer.encode != "json" || !json.is_object())
        return daemon_sent("something else than a JSON document");
    return json;
}

}  // namespace raynest::client
