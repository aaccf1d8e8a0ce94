// The stream of a backup: the same bytes come out, however they are cut, and sizes of any length.
#include "server/store/archive.h"

#include "engine/scene/digest.h"
#include "tests/temporary_folder.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

namespace fs = std::filesystem;

struct Files {
    test::TemporaryFolder folder;
    const fs::path path = folder.path();

    fs::path write(const std::string& name, const std::string& bytes) const {
        std::ofstream(path / name, std::ios::binary) << bytes;
        return path / name;
    }
    static std::string read(const fs::path& file) {
        std::ifstream stream(file, std::ios::binary);
        std::string bytes(fs::file_size(file), '\0');
        stream.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
        return bytes;
    }
};

std::string digest_of(const std::string& bytes) {
    return arena_digest(std::as_bytes(std::span(bytes))).value();
}

std::vector<std::byte> stream_of(ArchiveSource& source, std::uint64_t piece) {
    std::vector<std::byte> whole(source.bytes());
    for (std::uint64_t at = 0; at < whole.size(); at += piece)
        REQUIRE(source.read(
            at, std::span(whole).subspan(at, std::min<std::uint64_t>(piece, whole.size() - at))));
    return whole;
}

TEST_CASE_FIXTURE(Files, "a backup comes out as it went in, however it is cut") {
    std::map<std::string, std::string> contents;
    for (const std::size_t size :
         {std::size_t{0}, std::size_t{512}, digest_piece_bytes, std::size_t{170'001}})
        contents[digest_of(std::string(size, 'c'))] = std::string(size, 'c');
    ArchiveSource source;
    const std::string manifest(1'000, 'm');
    source.add("manifest.sqlite", write("m", manifest), manifest.size());
    for (const auto& [name, bytes] : contents)
        source.add("blobs/" + name, write(name.substr(0, 9), bytes), bytes.size());
    const auto state = StateFolder::open(path).value();
    for (const std::uint64_t piece :
         {std::uint64_t{1}, std::uint64_t{511}, std::uint64_t{100'000}}) {
        CAPTURE(piece);
        const auto whole = stream_of(source, piece);
        {
            ArchiveTarget target(*state);
            for (std::uint64_t at = 0; at < whole.size(); at += piece)
                REQUIRE(target.take(std::span(whole).subspan(
                    at, std::min<std::uint64_t>(piece, whole.size() - at))));
            REQUIRE(target.finish());
            CHECK(read(target.manifest()) == manifest);
            REQUIRE(target.blobs().size() == contents.size());
            for (const auto& [name, blob] : target.blobs()) {
                CHECK(read(blob.file) == contents.at(name));
                CHECK(blob.bytes == contents.at(name).size());
            }
        }
        // A blob whose bytes have changed is left out, alone.
        std::vector<std::byte> flipped = whole;
        flipped[flipped.size() - 2 * tar_block_bytes - 600] ^= std::byte{1};
        {
            ArchiveTarget target(*state);
            REQUIRE(target.take(flipped));
            REQUIRE(target.finish());
            CHECK(target.blobs().size() == contents.size() - 1);
        }
        state->collect();
        CHECK(fs::is_empty(path / "blobs"));
        {
            ArchiveTarget target(*state);
            const std::size_t manifest_end = tar_block_bytes + 1'024;
            REQUIRE(target.take(std::span(whole).first(manifest_end)));
            REQUIRE(target.has_manifest());
            const std::string one = digest_of(std::string(512, 'c'));
            target.want({one});
            REQUIRE(target.take(std::span(whole).subspan(manifest_end)));
            REQUIRE(target.finish());
            REQUIRE(target.blobs().size() == 1);
            CHECK(target.blobs().contains(one));
        }
        // One byte less of the last file and its padding is one that was cut off.
        ArchiveTarget cut(*state);
        REQUIRE(cut.take(std::span(whole).first(whole.size() - 2 * tar_block_bytes)));
        CHECK_FALSE(cut.finish());
    }
}

TEST_CASE_FIXTURE(Files, "a file beyond 8 GiB keeps its size") {
    constexpr std::uint64_t bytes = (9ULL << 30) + 5;
    const fs::path large = write("large", "x");
    fs::resize_file(large, bytes);  // sparse
    ArchiveSource source;
    source.add("blobs/" + std::string(64, 'd'), large, bytes);
    CHECK(source.bytes() == 512 + (9ULL << 30) + 512 + 1024);
    std::vector<std::byte> head(tar_block_bytes);
    REQUIRE(source.read(0, head));
    std::uint64_t size = 0;
    for (std::size_t i = 124 + 4; i < 124 + 12; ++i)
        size = size << 8 | std::to_integer<std::uint64_t>(head[i]);
    CHECK(size == bytes);
    CHECK(head[124] == std::byte{0x80});
    std::vector<std::byte> end(3);
    REQUIRE(source.read(512 + bytes - 1, end));
    CHECK(end == std::vector<std::byte>(3));
    // Its head is one that the other side takes.
    const auto state = StateFolder::open(path).value();
    ArchiveTarget target(*state);
    REQUIRE(target.take(head));
    CHECK(target.blobs().contains(std::string(64, 'd')));
    std::vector<std::byte> wrong = head;
    wrong[124 + 11] ^= std::byte{1};
    ArchiveTarget other(*state);
    CHECK_FALSE(other.take(wrong));
}

TEST_CASE_FIXTURE(Files, "a source that is shorter than it was fails") {
    ArchiveSource source;
    source.add("manifest.sqlite", write("m", "short"), 1'000);
    std::vector<std::byte> whole(source.bytes());
    CHECK_FALSE(source.read(0, whole));
}

}  // namespace
}  // namespace raynest::server
