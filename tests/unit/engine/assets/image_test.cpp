#include "engine/assets/images/image.h"

#include "tests/unit/engine/assets/samples.h"

#include <cstdlib>
#include <cstring>
#include <utility>
#if defined(__SANITIZE_ADDRESS__)
#include <sanitizer/lsan_interface.h>
#endif

using namespace raynest;
using test::Bytes;
using test::raw_png;

namespace {

constexpr std::uint32_t side_max = 4096;
constexpr std::uint64_t picture_bytes_max = 64U << 20;

std::vector<std::uint8_t> pixels_of(const Bytes& file) {
    const auto image = decode_image(file, side_max, picture_bytes_max);
    REQUIRE_MESSAGE(image.has_value(), (image ? "" : image.error().message));
    return image->rgba;
}

/// Returns a 64 x 48 picture with noise in every channel, alpha included.
std::vector<std::uint8_t> noise() {
    std::vector<std::uint8_t> rgba(64 * 48 * 4);
    std::uint32_t state = 1;
    for (std::uint8_t& value : rgba) {
        state = state * 1664525U + 1013904223U;
        value = static_cast<std::uint8_t>(state >> 24);
    }
    return rgba;
}

}  // namespace

TEST_CASE("a PNG comes back bit for bit, straight alpha included" * doctest::test_suite("images")) {
    if (!test::have_images()) return;
    const auto rgba = noise();
    const auto file = encode_png(64, 48, rgba);
    REQUIRE(file.has_value());
    CHECK(pixels_of(*file) == rgba);
}

TEST_CASE("files of incompressible noise stay within the stated bound" *
          doctest::test_suite("images")) {
    if (!test::have_images()) return;
    for (const auto& [width, height] :
         {std::pair{1U, 1U}, {1U, 3000U}, {3000U, 1U}, {700U, 401U}}) {
        std::vector<std::uint8_t> rgba(std::size_t{4} * width * height);
        std::uint64_t state = 1;
        for (std::uint8_t& value : rgba) {
            state = state * 6364136223846793005U + 1442695040888963407U;
            value = static_cast<std::uint8_t>(state >> 56);
        }
        const auto png = encode_png(width, height, rgba);
        REQUIRE(png);
        CHECK(png->size() >= rgba.size());
        CHECK(png->size() <= png_bytes_max(width, height));
        std::vector<std::uint32_t> words(std::size_t{width} * height);
        std::memcpy(words.data(), rgba.data(), rgba.size());
        const std::vector<Channel> channels = {{"a", {}, words}, {"b", {}, words}};
        const auto exr = encode_exr(width, height, channels);
        REQUIRE(exr);
        CHECK(exr->size() <= exr_bytes_max(width, height, 2));
    }
}

TEST_CASE("grey, grey with alpha, palette and 16-bit pictures become RGBA8" *
          doctest::test_suite("images")) {
    if (!test::have_images()) return;
    CHECK(pixels_of(raw_png(2, 1, 8, 0, std::string("\0\x10\x20", 3))) ==
          std::vector<std::uint8_t>{16, 16, 16, 255, 32, 32, 32, 255});
    CHECK(pixels_of(raw_png(1, 1, 8, 4, std::string("\0\x10\x80", 3))) ==
          std::vector<std::uint8_t>{16, 16, 16, 128});
    CHECK(
        pixels_of(raw_png(2, 1, 8, 3, std::string("\0\x01\x00", 3), "\x01\x02\x03\x04\x05\x06")) ==
        std::vector<std::uint8_t>{4, 5, 6, 255, 1, 2, 3, 255});
    CHECK(pixels_of(raw_png(1, 1, 16, 6, std::string("\0\x80\x80\x40\x40\x20\x20\xFF\xFF", 9))) ==
          std::vector<std::uint8_t>{128, 64, 32, 255});
}

TEST_CASE("a WebP keeps its straight alpha" * doctest::test_suite("images")) {
    if (!test::have_images()) return;
    // 16 x 16 pixels of (200, 100, 50, 128), lossless.
    const std::string file(
        "\x52\x49\x46\x46\x1e\x00\x00\x00\x57\x45\x42\x50\x56\x50\x38\x4c\x11\x00\x00"
        "\x00\x2f\x0f\xc0\x03\x10\x07\x50\xb2\x22\x57\xa6\x80\x81\x88\xe8\x7f\x00\x00",
        38);
    const auto pixels = pixels_of(test::to_bytes(file));
    REQUIRE(pixels.size() == 16 * 16 * 4);
    CHECK(std::abs(pixels[0] - 200) <= 1);
    CHECK(std::abs(pixels[1] - 100) <= 1);
    CHECK(std::abs(pixels[2] - 50) <= 1);
    CHECK(pixels[3] == 128);
}

TEST_CASE("a WebP keeps its colours where it is transparent, wholly or almost" *
          doctest::test_suite("images")) {
    if (!test::have_images()) return;
    // 4 pixels of (128, 127, 200), of alpha 0, 1, 5 and 40, lossless.
    const std::string file(
        "\x52\x49\x46\x46\x26\x00\x00\x00\x57\x45\x42\x50\x56\x50\x38\x4c\x19\x00\x00"
        "\x00\x2f\x03\x00\x00\x10\x1f\x30\x7f\x03\x38\xc8\x04\x02\x94\xa9\xc2\x13\x71"
        "\x20\x86\xa3\xe4\x11\xfd\x0f\x00",
        46);
    CHECK(pixels_of(test::to_bytes(file)) == std::vector<std::uint8_t>{128, 127, 200, 0, 128, 127,
                                                                       200, 1, 128, 127, 200, 5,
                                                                       128, 127, 200, 40});
    for (std::size_t length = 12; length < file.size() - 2; ++length) {
        CAPTURE(length);
        CHECK_FALSE(
            decode_image(test::to_bytes(file.substr(0, length)), side_max, picture_bytes_max)
                .has_value());
    }
    const auto refused = decode_image(test::to_bytes(file), 3, picture_bytes_max);
    REQUIRE_FALSE(refused.has_value());
    CHECK(refused.error().code == ErrorCode::limit_exceeded);
}

TEST_CASE("a JPEG may lack its end marker, and no more" * doctest::test_suite("images")) {
    if (!test::have_images()) return;
    // 16 x 16 grey pixels.
    const std::string file(
        "\xff\xd8\xff\xe0\x00\x10\x4a\x46\x49\x46\x00\x01\x01\x00\x00\x01\x00\x01\x00"
        "\x00\xff\xdb\x00\x43\x00\x1b\x12\x14\x17\x14\x11\x1b\x17\x16\x17\x1e\x1c\x1b"
        "\x20\x28\x42\x2b\x28\x25\x25\x28\x51\x3a\x3d\x30\x42\x60\x55\x65\x64\x5f\x55"
        "\x5d\x5b\x6a\x78\x99\x81\x6a\x71\x90\x73\x5b\x5d\x85\xb5\x86\x90\x9e\xa3\xab"
        "\xad\xab\x67\x80\xbc\xc9\xba\xa6\xc7\x99\xa8\xab\xa4\xff\xc0\x00\x0b\x08\x00"
        "\x10\x00\x10\x01\x01\x11\x00\xff\xc4\x00\x15\x00\x01\x01\x00\x00\x00\x00\x00"
        "\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x03\xff\xc4\x00\x1e\x10\x01\x00\x02"
        "\x03\x01\x01\x00\x03\x00\x00\x00\x00\x00\x00\x00\x00\x01\x02\x21\x03\x11\x12"
        "\x00\x32\x22\x41\x52\xff\xda\x00\x08\x01\x01\x00\x00\x3f\x00\x9e\x8c\x78\xf9"
        "\x40\xc7\x22\x80\x61\x16\x82\x8f\xa9\x17\x67\x9a\x11\xd6\x29\x87\x0b\xf8\x92"
        "\x10\x6f\xf8\x8d\xa5\x52\xbe\x63\x6a\xba\xdc\xb5\xd9\x2e\x7a\x77\x43\x92\x57"
        "\xb0\x3f\x45\xfa\x3a\x31\xe3\xe5\x03\x1c\x8a\x01\x84\x5a\x0a\x3e\xa4\x5d\x9e"
        "\xff\xd9",
        230);
    const auto whole = pixels_of(test::to_bytes(file));
    REQUIRE(whole.size() == 16 * 16 * 4);
    // The marker has two bytes.
    for (const std::size_t without : {1U, 2U})
        CHECK(pixels_of(test::to_bytes(file.substr(0, file.size() - without))) == whole);
    for (std::size_t without = 5; without < file.size(); ++without) {
        CAPTURE(without);
        CHECK_FALSE(decode_image(test::to_bytes(file.substr(0, file.size() - without)), side_max,
                                 picture_bytes_max)
                        .has_value());
    }
}

TEST_CASE("an oversized picture is refused by its header" * doctest::test_suite("images")) {
    if (!test::have_images()) return;
    const Bytes wide = raw_png(5000, 2, 8, 0, std::string("\0\x10", 2));
    const auto too_wide = decode_image(wide, side_max, picture_bytes_max);
    REQUIRE_FALSE(too_wide.has_value());
    CHECK(too_wide.error().code == ErrorCode::limit_exceeded);
    const auto too_many =
        decode_image(raw_png(4000, 4000, 8, 0, std::string("\0\x10", 2)), side_max, 1 << 20);
    REQUIRE_FALSE(too_many.has_value());
    CHECK(too_many.error().code == ErrorCode::limit_exceeded);
}

TEST_CASE("a PNG cut anywhere is an error" * doctest::test_suite("images")) {
    if (!test::have_images()) return;
#if defined(__SANITIZE_ADDRESS__)
    // libpng jumps out of OpenImageIO's read callback, past the end of a string there. The leak is
    // theirs, and harmless in a short-lived import child.
    const __lsan::ScopedDisabler not_ours;
#endif
    const auto file = encode_png(64, 48, noise());
    REQUIRE(file.has_value());
    // The last 12 bytes are the end chunk, which holds no pixel.
    for (std::size_t length = 0; length + 12 < file->size(); length += 37) {
        CAPTURE(length);
        CHECK_FALSE(
            decode_image(std::span(*file).first(length), side_max, picture_bytes_max).has_value());
    }
}

TEST_CASE("a JPEG cut anywhere is an error" * doctest::test_suite("shared scenes")) {
    if (!test::have_shared_scenes() || !test::have_images()) return;
    // Take the first JPEG inside a scene, from its start marker to the end of its bufferView; data
    // after the end marker does not matter.
    const Bytes scene = test::read_file(test::shared_scene("temple.glb"));
    const std::string_view text(reinterpret_cast<const char*>(scene.data()), scene.size());
    const std::size_t at = text.find("\xFF\xD8\xFF\xE0");
    REQUIRE(at != std::string_view::npos);
    const auto rest = std::span(scene).subspan(at);
    REQUIRE(decode_image(rest, side_max, picture_bytes_max).has_value());
    const std::size_t end = text.find("\xFF\xD9", at) + 2 - at;
    for (std::size_t length = 0; length < end; length += 97) {
        CAPTURE(length);
        CHECK_FALSE(decode_image(rest.first(length), side_max, picture_bytes_max).has_value());
    }
}

TEST_CASE("only PNG, JPEG and WebP are decoded" * doctest::test_suite("images")) {
    if (!test::have_images()) return;
    for (const char* magic : {"BM", "GIF89a", "v/1\x01", "DDS ", "II*", "P6\n", "RIFF1234AVI "}) {
        const auto image =
            decode_image(test::to_bytes(magic + std::string(64, 'x')), side_max, picture_bytes_max);
        REQUIRE_FALSE(image.has_value());
        CHECK(image.error().code == ErrorCode::scene_unsupported);
    }
}

TEST_CASE("an EXR holds floats and counts by name" * doctest::test_suite("images")) {
    if (!test::have_images()) return;
    const std::vector<float> depth{1.5F, -2, 0, 4};
    const std::vector<std::uint32_t> prim{1, 0xFFFFFFFFU, 3, 4};
    const Channel channels[] = {{"Z", depth, {}}, {"prim", {}, prim}};
    const auto file = encode_exr(2, 2, channels);
    REQUIRE(file.has_value());
    const std::string_view text(reinterpret_cast<const char*>(file->data()), file->size());
    CHECK(text.starts_with("v/1\x01"));
    // The channel list: name, zero, pixel type (0 = UINT, 2 = FLOAT).
    CHECK(text.find(std::string("Z\0\2\0\0\0", 6)) != std::string_view::npos);
    CHECK(text.find(std::string("prim\0\0\0\0\0", 9)) != std::string_view::npos);
}

TEST_CASE("a channel that does not fill the picture is refused") {
    const std::vector<float> three{1, 2, 3};
    const Channel channels[] = {{"Z", three, {}}};
    CHECK_FALSE(encode_exr(2, 2, channels).has_value());
    CHECK_FALSE(encode_png(2, 2, std::vector<std::uint8_t>(15)).has_value());
}
