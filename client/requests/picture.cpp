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

/// Appends the bytes of a frame after checking that they are the next ones. Passes a whole picture
/// on, if a later one will replace it.
Result<void> take_piece(const protocol::Frame& frame, ReceivedPicture& picture,
                        const PassConsumer& consume_pass) {
    const auto opened = protocol::open<wire::Picture>(frame);
    if (!opened) return tl::unexpected<Failure>(failure(opened.error()));
    const wire::Picture& piece = *opened->table;
    const protocol::BlockView* data = protocol::find_block(opened->blocks, "data");
    if (piece.offset() == 0) picture.bytes.clear();
    if (data == nullptr || piece.offset() != picture.bytes.size() ||
        data->bytes.size() > piece.total() - std::min(piece.offset(), piece.total()))
        return fail(Exit::failed, "the daemon sent pieces of a picture that do not fit together");
    picture.width = piece.width();
    picture.height = piece.height();
    picture.encode = protocol::text(piece.encode());
    picture.exposure = piece.exposure();
    picture.bytes.insert(picture.bytes.end(), data->bytes.begin(), data->bytes.end());
    const bool is_pass = !piece.last() && picture.bytes.size() == piece.total();
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

Result<ReceivedPicture> receive_picture(Connection& connection, Progress& progress,
                                        ReceivedPicture picture, const PassConsumer& consume_pass) {
    while (true) {
        const auto frame = connection.next();
        if (!frame) return tl::unexpected<Failure>(frame.error());
        if (auto taken = take_news(*frame, picture.outcome); !taken)
            return tl::unexpected<Failure>(taken.error());
        if (is<wire::Done>(*frame) || is<wire::Detached>(*frame)) return picture;
        if (is<wire::Picture>(*frame)) {
            if (auto taken = take_piece(*frame, picture, consume_pass); !taken)
                return tl::unexpected<Failure>(taken.error());
        } else if (is<wire::Progress>(*frame)) {
            const auto news = protocol::open<wire::Progress>(*frame);
            if (!news) return tl::unexpected<Failure>(failure(news.error()));
            progress.update((*news)->done(), (*news)->total(), stage_text(*news->table));
        }
    }
}

Result<std::vector<std::byte>> npy_file(const ReceivedPicture& picture, const char* dtype,
                                        std::vector<std::uint64_t> shape) {
    if (picture.bytes.size() != 4ULL * picture.width * picture.height)
        return fail(Exit::failed, "the daemon sent pixels of another number than the picture has");
    return format_npy({dtype, std::move(shape), picture.bytes});
}

Result<Json> read_json(const ReceivedPicture& answer) {
    const auto* text = reinterpret_cast<const char*>(answer.bytes.data());
    // Deeper documents would exhaust the stack of whoever walks through them.
    bool is_deep = false;
    const auto look = [&](int depth, Json::parse_event_t, Json&) {
        is_deep = is_deep || depth > document_depth_max;
        return !is_deep;
    };
    Json json = Json::parse(text, text + answer.bytes.size(), look, false);
    if (is_deep || answer.encode != "json" || json.is_discarded())
        return fail(Exit::failed, "the daemon sent something else than a JSON document");
    return json;
}

}  // namespace raynest::client
