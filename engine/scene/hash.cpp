#include "engine/scene/hash.h"

#include <bit>
#include <cstdint>
#include <cstring>

namespace raynest {
namespace {

// Odd multipliers from the fraction of the golden ratio and of sqrt(2).
constexpr std::uint64_t golden = 0x9E3779B97F4A7C15ULL;
constexpr std::uint64_t silver = 0x6A09E667F3BCC909ULL;

/// One lane over 8-byte words. Each step is a bijection of the state, so that two inputs that
/// differ in one word never meet again by themselves.
struct Lane {
    std::uint64_t state;
    std::uint64_t multiplier;
    int rotation;

    void add(std::uint64_t word) { state = std::rotl(state ^ word, rotation) * multiplier + 1; }
};

/// Every input bit reaches every output bit (the finaliser's shape is Murmur3's).
std::uint64_t avalanche(std::uint64_t x) {
    x = (x ^ (x >> 32)) * golden;
    x = (x ^ (x >> 29)) * silver;
    return x ^ (x >> 32);
}

void append_hex(std::string& out, std::uint64_t value) {
    for (int shift = 60; shift >= 0; shift -= 4) out += "0123456789abcdef"[(value >> shift) & 15];
}

}  // namespace

std::string content_hash(std::span<const std::byte> bytes) {
    Lane a{golden, silver, 27};
    Lane b{silver, golden, 31};
    const auto add = [&](std::uint64_t word) {
        a.add(word);
        b.add(word);
    };

    std::size_t at = 0;
    for (; bytes.size() - at >= 8; at += 8) {
        std::uint64_t word = 0;
        std::memcpy(&word, bytes.data() + at, 8);
        add(word);
    }
    // The tail is zero-filled; the length keeps "ab" and "ab\0" apart.
    std::uint64_t tail = 0;
    if (at < bytes.size()) std::memcpy(&tail, bytes.data() + at, bytes.size() - at);
    add(tail);
    add(bytes.size());

    std::string hex;
    append_hex(hex, avalanche(a.state + std::rotl(b.state, 17)));
    append_hex(hex, avalanche(b.state ^ std::rotl(a.state, 43)));
    return hex;
}

}  // namespace raynest
