#include "client/requests/send_file.h"

#include "protocol/blocks.h"

#include <algorithm>
#include <cstring>
#include <utility>

namespace raynest::client {
namespace {

constexpr std::uint64_t piece_bytes = 1ULL << 20;

}  // namespace

Result<void> send_file(Connection& connection, std::uint32_t number, std::uint64_t bytes,
                       const ReadFile& read, Progress& progress, const FrameConsumer& consume,
                       const Among& among) {
    for (std::uint64_t offset = 0; offset < bytes;) {
        const std::uint64_t count = std::min(
            {bytes - offset, piece_bytes, connection.bulk_bytes_max() & ~std::uint64_t{63}});
        while (connection.credit() < protocol::padded(count)) {
            const auto frame = connection.next();
            if (!frame) return tl::unexpected<Failure>(frame.error());
            if (auto taken = consume(*frame); !taken) return taken;
        }
        protocol::Bulk bulk;
        bulk.add("data", wire::Dtype::u8, 1, count);
        bulk.allocate();
        if (auto done = read(offset, bulk.block(0)); !done) return done;
        wire::UploadT piece;
        piece.file = number;
        piece.offset = offset;
        if (auto done = connection.send_bulk(std::move(piece), std::move(bulk)); !done) return done;
        offset += count;
        progress.update(among.before + offset, among.total == 0 ? bytes : among.total, "uploading");
    }
    return {};
}

Result<void> send_file(Connection& connection, std::uint32_t number,
                       std::span<const std::byte> bytes, Progress& progress,
                       const FrameConsumer& consume, const Among& among) {
    const auto read = [bytes](std::uint64_t offset, std::span<std::byte> into) -> Result<void> {
        std::memcpy(into.data(), bytes.data() + offset, into.size());
        return {};
    };
    return send_file(connection, number, bytes.size(), read, progress, consume, among);
}

}  // namespace raynest::client
