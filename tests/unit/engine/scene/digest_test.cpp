#include "engine/scene/digest.h"

#include <doctest/doctest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cstdint>
#include <set>
#include <string>
#include <vector>

namespace {

std::string digest_of(std::span<const std::byte> bytes) {
    const auto digest = raynest::arena_digest(bytes);
    REQUIRE_MESSAGE(digest.has_value(), (digest ? "" : digest.error().message));
    return *digest;
}

std::string digest_of(const std::string& text) {
    return digest_of(std::as_bytes(std::span(text)));
}

/// Bytes of a fixed sequence.
std::vector<std::byte> some_bytes(std::size_t count) {
    std::vector<std::byte> bytes(count);
    std::uint32_t state = 1;
    for (std::byte& byte : bytes) {
        state = state * 1664525 + 1013904223;
        byte = static_cast<std::byte>(state >> 24);
    }
    return bytes;
}

void flip_bit(std::vector<std::byte>& bytes, std::size_t bit) {
    bytes[bit / 8] ^= static_cast<std::byte>(1U << (bit % 8));
}

constexpr std::size_t piece = 1 << 16;

}  // namespace

// The values were computed with Python's hashlib; for "abc" it is SHA-256 of the digest that FIPS
// 180-2 gives.
TEST_CASE("the digest of known bytes is SHA-256 over the list of the pieces' SHA-256") {
    CHECK(digest_of("") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    CHECK(digest_of("abc") == "4f8b42c22dd3729b519ba6f68d2da7cc5b2d606d05daed5ad5128cc03e6c6358");
    CHECK(digest_of(std::string(1'000'000, 'a')) ==
          "de9872d777d61bad1865356f71b4a960d9303c6eaa6051b6fd0ef4aac8868a92");
    CHECK(digest_of(std::string(piece, 'a')) ==
          "b08436e754e78d8edd1fbf2a7914d90363ecdf0fd99366b5676d9180989b16ca");
    CHECK(digest_of(std::string(piece + 1, 'a')) ==
          "b0721578fd2489cfe734537ef6ed6ee8a55a8fc3a76846e10ce4f45b71f38480");
    CHECK(digest_of(some_bytes(3 * piece + 12345)) ==
          "2dd21fd5b6572341e1e1a9581eb8f1b8d8f9e2102799089029f7d032bbc75296");
}

TEST_CASE("every single-bit change and every length has a digest of its own") {
    std::set<std::string> seen;
    std::size_t inputs = 0;
    for (std::size_t length = 0; length <= 40; ++length) {
        std::vector<std::byte> bytes(length);
        seen.insert(digest_of(bytes));
        ++inputs;
        for (std::size_t bit = 0; bit < 8 * length; ++bit) {
            flip_bit(bytes, bit);
            seen.insert(digest_of(bytes));
            ++inputs;
            flip_bit(bytes, bit);
        }
    }
    CHECK(seen.size() == inputs);
}

TEST_CASE("a flipped bit in any piece, and two pieces that change places, change the digest") {
    std::vector<std::byte> bytes = some_bytes(3 * piece + 100);
    std::set<std::string> seen{digest_of(bytes)};
    const std::vector<std::size_t> at{0,         piece - 1,       piece, 2 * piece + 777,
                                      3 * piece, bytes.size() - 1};
    for (const std::size_t byte : at) {
        flip_bit(bytes, 8 * byte + byte % 8);
        seen.insert(digest_of(bytes));
        flip_bit(bytes, 8 * byte + byte % 8);
    }
    std::swap_ranges(bytes.begin(), bytes.begin() + piece, bytes.begin() + piece);
    seen.insert(digest_of(bytes));
    CHECK(seen.size() == at.size() + 2);
}

TEST_CASE("words that a fast hash confuses have digests of their own") {
    // Both pairs of words had one 128-bit hash when scenes were told apart by two lanes of
    // rotations and multiplications: in one lane the second word makes up for any change of the
    // first.
    const std::uint64_t one[2] = {0x4A84809EDBA03013U, 0};
    const std::uint64_t other[2] = {0x0A0DC1D3EADC7450U, 0x14A817E2AE59F1CEU};
    CHECK(digest_of(std::as_bytes(std::span(one))) != digest_of(std::as_bytes(std::span(other))));
    // Bit 36 of a word and bit 63 of the next left that lane as it was.
    const std::vector<std::byte> bytes = some_bytes(4096);
    std::set<std::string> seen{digest_of(bytes)};
    std::size_t inputs = 1;
    for (std::size_t word = 0; word + 1 < bytes.size() / 8; ++word) {
        std::vector<std::byte> changed = bytes;
        flip_bit(changed, 64 * word + 36);
        flip_bit(changed, 64 * (word + 1) + 63);
        seen.insert(digest_of(changed));
        ++inputs;
    }
    CHECK(seen.size() == inputs);
}

TEST_CASE("the digest is the same on 1, 2, 3 and 8 threads") {
    const std::vector<std::byte> bytes = some_bytes(9 * piece + 1);
    std::set<std::string> seen;
    for (const std::size_t threads : {1U, 2U, 3U, 8U}) {
        const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
        seen.insert(digest_of(bytes));
    }
    CHECK(seen.size() == 1);
}
