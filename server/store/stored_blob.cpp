// Reads the blob of a scene.
#include "server/store/file.h"
#include "server/store/state_folder.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <string>
#include <utility>

namespace raynest::server {
namespace fs = std::filesystem;
namespace {

/// Tells the inode of the file, once it is open.
tl::expected<Pages, BlobFault> read_blob(const fs::path& path, std::uint64_t bytes,
                                         std::uint64_t& inode) {
    const File file(path, O_RDONLY);
    if (!file.is_open())
        return tl::unexpected(
            BlobFault{errno == ENOENT, errno == ENOENT ? "its file is gone" : reason(errno)});
    struct stat found {};
    if (::fstat(file.number(), &found) != 0) return tl::unexpected(BlobFault{false, reason(errno)});
    inode = found.st_ino;
    if (static_cast<std::uint64_t>(found.st_size) != bytes)
        return tl::unexpected(BlobFault{
            true, fmt::format("its file has {} bytes in place of {}", found.st_size, bytes)});
    Pages arena(bytes);
    constexpr std::size_t read_step_bytes = 8 << 20;
    std::size_t at = 0;
    while (at < bytes) {
        const ssize_t done =
            ::read(file.number(), arena.data() + at, std::min(bytes - at, read_step_bytes));
        if (done < 0 && errno == EINTR) continue;
        if (done < 0) return tl::unexpected(BlobFault{false, reason(errno)});
        if (done == 0) return tl::unexpected(BlobFault{true, "its file was cut"});
        at += static_cast<std::size_t>(done);
    }
    return arena;
}

}  // namespace

tl::expected<std::shared_ptr<const Snapshot>, BlobFault> read_stored(const fs::path& folder,
                                                                     const std::string& digest,
                                                                     std::uint64_t bytes,
                                                                     std::string content) {
    if (!is_digest(digest)) return tl::unexpected(BlobFault{false, "it has no blob"});
    std::uint64_t inode = 0;
    const auto fault = [&](BlobFault of) {
        of.inode = inode;
        return tl::unexpected(std::move(of));
    };
    auto arena = read_blob(folder / "blobs" / digest, bytes, inode);
    if (!arena) return fault(std::move(arena.error()));
    auto opened = Snapshot::reopen({std::move(*arena), 0, {}}, std::move(content));
    if (!opened)
        return fault({true, std::move(opened.error().message),
                      opened.error().code == ErrorCode::scene_unsupported});
    if ((*opened)->arena_id() != digest) return fault({true, "its bytes have changed"});
    return std::move(*opened);
}

}  // namespace raynest::server
