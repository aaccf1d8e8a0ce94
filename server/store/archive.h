// A copy of a state folder as one stream: a tar file with the folder raynest-state, which is what
// back_up() makes. Whoever unpacks it with tar has a folder for raynestd check and restore.
//
//   raynest-state/manifest.sqlite     first
//   raynest-state/blobs/DIGEST        one for each content
#pragma once

#include "engine/result.h"
#include "server/store/file.h"
#include "server/store/state_folder.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

namespace raynest::server {

/// Unit of a tar file: heads have this size, and files are padded to it.
inline constexpr std::size_t tar_block_bytes = 512;

/// The stream, made from files that do not change. Not thread-safe; blocks.
class ArchiveSource {
public:
    /// Adds a file under this name; it has `bytes`.
    void add(const std::string& name, std::filesystem::path file, std::uint64_t bytes);
    [[nodiscard]] std::uint64_t bytes() const;
    /// Copies the bytes from `offset` on. Fails with io_failed if a file cannot be read or is shorter.
    [[nodiscard]] Result<void> read(std::uint64_t offset, std::span<std::byte> into);

private:
    struct Part {
        std::filesystem::path file;
        std::uint64_t bytes = 0;
        std::uint64_t first = 0;  ///< offset of its head
        std::array<std::byte, tar_block_bytes> head{};
    };
    std::vector<Part> parts_;
    std::uint64_t end_ = 0;  ///< end of the last part, padded
    std::size_t open_part_ = 0;
    std::unique_ptr<File> open_;  ///< that of open_part_
};

/// Takes such a stream apart, as bytes come, into files of the state folder that no scene has yet.
/// Takes what tar makes of the unpacked folder, too. Not thread-safe; blocks.
class ArchiveTarget {
public:
    explicit ArchiveTarget(StateFolder& state) : state_(state) {}
    ArchiveTarget(const ArchiveTarget&) = delete;
    ArchiveTarget& operator=(const ArchiveTarget&) = delete;
    /// Discards the files that are still there.
    ~ArchiveTarget();

    /// Fails with scene_invalid where the bytes are no backup, and with io_failed if the disk is full
    /// or fails.
    [[nodiscard]] Result<void> take(std::span<const std::byte> bytes);
    /// Says that no more comes. Fails with scene_invalid for a stream that was cut off.
    [[nodiscard]] Result<void> finish();

    [[nodiscard]] const std::filesystem::path& manifest() const { return manifest_; }
    /// True once all of the manifest has come.
    [[nodiscard]] bool has_manifest() const { return has_manifest_; }
    /// Skips blobs that come from now on but those of these digests.
    void want(std::set<std::string> digests) { wanted_ = std::move(digests); }
    struct Blob {
        std::filesystem::path file;
        std::uint64_t bytes = 0;
    };
    /// The blobs, flushed, by digest. Those whose bytes have another are left out.
    [[nodiscard]] const std::map<std::string, Blob>& blobs() const { return blobs_; }

private:
    [[nodiscard]] Result<void> begin(std::span<const std::byte> head);
    [[nodiscard]] Result<void> end_file();
    /// Hashes a piece of a blob, as arena_digest() does.
    [[nodiscard]] Result<void> hash_piece();

    StateFolder& state_;
    std::vector<std::byte> head_;  ///< what has come of the next one
    std::unique_ptr<File> file_;   ///< null: what comes is skipped
    std::uint64_t left_ = 0;       ///< bytes of the file that are to come
    std::size_t padding_ = 0;      ///< and of its padding
    std::string blob_;             ///< the digest that the file is to have; empty: it is no blob
    std::vector<std::byte> piece_;
    std::vector<unsigned char> digests_;  ///< digests of the pieces before it
    bool ended_ = false;
    bool has_manifest_ = false;
    std::optional<std::set<std::string>> wanted_;  ///< nothing: all
    std::filesystem::path manifest_;
    std::map<std::string, Blob> blobs_;
};

}  // namespace raynest::server
