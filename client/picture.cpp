#include "client/picture.h"

#include "client/files.h"
#include "client/npy.h"

#include <algorithm>
#include <utility>

namespace raynest::client {
namespace {

/// Appends the bytes of a frame after checking that they are the next ones.
Result<void> take_piece(const protocol::Frame& frame, ReceivedPicture& picture) {
    const auto opened = protocol::open<wire::Picture>(frame);
    if (!opened) return tl::unexpected<Failure>(failure(opened.error()));
    const wire::Picture& piece = *opened->table;
    const protocol::BlockView* data = protocol::find_block(opened->blocks, "data");
    if (data == nullptr || piece.offset() != picture.bytes.size() ||
        data->bytes.size() > piece.total() - std::min(piece.offset(), piece.total()))
        return fail(Exit::failed, "the daemon sent pieces of a picture that do not fit together");
    picture.width = piece.width();
    picture.height = piece.height();
    picture.encode = protocol::text(piece.encode());
    picture.bytes.insert(picture.bytes.end(), data->bytes.begin(), data->bytes.end());
    return {};
}

}  // namespace

std::string encoding_of(const std::string& output) {
    const std::string ending = extension_of(output);
    if (output == standard_stream || ending.empty() || ending == ".html") return "png";
    return ending == ".npy" ? "raw" : ending.substr(std::min<std::size_t>(1, ending.size()));
}

Result<ReceivedPicture> receive_picture(Connection& connection, Progress& progress) {
    ReceivedPicture picture;
    while (true) {
        const auto frame = connection.next();
        if (!frame) return tl::unexpected<Failure>(frame.error());
        if (auto taken = take_news(*frame, picture.outcome); !taken)
            return tl::unexpected<Failure>(taken.error());
        if (is<wire::Done>(*frame) || is<wire::Detached>(*frame)) return picture;
        if (is<wire::Picture>(*frame)) {
            if (auto taken = take_piece(*frame, picture); !taken)
                return tl::unexpected<Failure>(taken.error());
        } else if (is<wire::Progress>(*frame)) {
            const auto news = protocol::open<wire::Progress>(*frame);
            if (!news) return tl::unexpected<Failure>(failure(news.error()));
            progress.update((*news)->done(), (*news)->total(), protocol::text((*news)->stage()));
        }
    }
}

Result<std::vector<std::byte>> npy_file(const ReceivedPicture& picture, const char* dtype,
                                        std::vector<std::uint64_t> shape) {
    if (picture.bytes.size() != 4ULL * picture.width * picture.height)
        return fail(Exit::failed, "the daemon sent pixels of another number than the picture has");
    return format_npy({dtype, std::move(shape), picture.bytes});
}

Json picture_json(const std::string& file, const ReceivedPicture& picture) {
    Json json = outcome_json(picture.outcome);
    json["file"] = file;
    json["width"] = picture.width;
    json["height"] = picture.height;
    return json;
}

std::string picture_text(const std::string& file, const ReceivedPicture& picture) {
    return file + ": " + std::to_string(picture.width) + "x" + std::to_string(picture.height) +
           ", " + outcome_text(picture.outcome);
}

}  // namespace raynest::client
