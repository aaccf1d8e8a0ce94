// EXR files that come back: decoded exactly, and refused when they are not as they were written.
#include "engine/assets/images/exr_header.h"
#include "tests/unit/engine/assets/samples.h"

#include <doctest/doctest.h>

#include <bit>
#include <random>
#include <vector>

using namespace raynest;

namespace {

constexpr std::uint32_t wide = 37;
constexpr std::uint32_t high = 35;

struct File {
    File() {
        std::mt19937 random(1);
        for (std::uint32_t i = 0; i < wide * high; ++i) {
            depth.push_back(static_cast<float>(random()) / 1e6F - 500);
            ids.push_back(static_cast<std::uint32_t>(random()));
        }
        const Channel channels[] = {{"Z", depth, {}}, {"R", depth, {}}, {"mesh", {}, ids}};
        const Attribute attributes[] = {{"raynest:seed", "7"}, {"raynest:scene", "forest"}};
        auto encoded = encode_exr(wide, high, channels, attributes);
        REQUIRE(encoded);
        bytes = std::move(*encoded);
    }
    [[nodiscard]] auto decode() const { return decode_exr(bytes, 1 << 14, 1 << 20); }

    std::vector<float> depth;
    std::vector<std::uint32_t> ids;
    std::vector<std::byte> bytes;
};

}  // namespace

TEST_CASE("an EXR comes back bit for bit, with its text" * doctest::test_suite("images")) {
    if (!test::have_images()) return;
    const File file;
    const auto header = read_exr_header(file.bytes);
    REQUIRE(header);
    CHECK(header->width == wide);
    CHECK(header->height == high);
    const auto has = [&](const char* name, const char* value) {
        for (const Attribute& one : header->attributes)
            if (one.name == name) return one.value == value;
        return false;
    };
    CHECK(has("raynest:seed", "7"));
    CHECK(has("raynest:scene", "forest"));
    const auto decoded = file.decode();
    REQUIRE(decoded);
    CHECK(decoded->width == wide);
    CHECK(decoded->height == high);
    const std::vector<ChannelType> types = {{"R", true}, {"mesh", false}, {"Z", true}};
    const auto places = find_channels(*header, wide, high, types);
    REQUIRE(places);
    REQUIRE(decoded->planes.size() == 3);
    CHECK(decoded->planes[(*places)[1]] == file.ids);
    for (std::size_t i = 0; i < file.depth.size(); ++i) {
        CHECK(decoded->planes[(*places)[0]][i] == std::bit_cast<std::uint32_t>(file.depth[i]));
        CHECK(decoded->planes[(*places)[2]][i] == std::bit_cast<std::uint32_t>(file.depth[i]));
    }
}

TEST_CASE("an EXR that is too large or cut short is refused" * doctest::test_suite("images")) {
    if (!test::have_images()) return;
    File file;
    constexpr std::uint64_t bytes = std::uint64_t{4} * 3 * wide * high;
    CHECK(decode_exr(file.bytes, wide, bytes));
    for (const auto& too_large :
         {decode_exr(file.bytes, wide - 1, bytes), decode_exr(file.bytes, wide, bytes - 1)}) {
        REQUIRE_FALSE(too_large);
        CHECK(too_large.error().code == ErrorCode::limit_exceeded);
    }
    const std::vector<std::byte> whole = file.bytes;
    for (std::size_t size = 0; size < whole.size(); size += size < 600 ? 1 : 97) {
        file.bytes.assign(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size));
        CHECK_FALSE(file.decode());
    }
    CHECK(decode_exr(std::vector<std::byte>(100), 1, 1).error().code ==
          ErrorCode::scene_unsupported);
}

TEST_CASE("an EXR with broken bytes is refused or decoded, and nothing else" *
          doctest::test_suite("images")) {
    if (!test::have_images()) return;
    File file;
    const std::vector<std::byte> whole = file.bytes;
    std::mt19937 random(2);
    for (int i = 0; i < 3000; ++i) {
        file.bytes = whole;
        // Half of the time in the header and the table of blocks.
        const std::size_t most = i % 2 == 0 ? 700 : whole.size();
        for (unsigned n = 0; n <= random() % 4; ++n)
            file.bytes[random() % std::min(most, whole.size())] = static_cast<std::byte>(random());
        const auto decoded = file.decode();
        if (decoded) CHECK(decoded->planes.size() <= 3);
    }
}
