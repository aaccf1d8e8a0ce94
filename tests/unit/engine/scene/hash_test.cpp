#include "engine/scene/hash.h"

#include <doctest/doctest.h>

#include <set>
#include <string>
#include <vector>

using raynest::content_hash;

TEST_CASE("every single-bit change and every length has a hash of its own") {
    std::set<std::string> seen;
    std::size_t inputs = 0;
    for (std::size_t length = 0; length <= 40; ++length) {
        std::vector<std::byte> bytes(length);
        seen.insert(content_hash(bytes));
        ++inputs;
        for (std::size_t bit = 0; bit < 8 * length; ++bit) {
            bytes[bit / 8] ^= static_cast<std::byte>(1U << (bit % 8));
            seen.insert(content_hash(bytes));
            ++inputs;
            bytes[bit / 8] ^= static_cast<std::byte>(1U << (bit % 8));
        }
    }
    CHECK(seen.size() == inputs);
}

TEST_CASE("the hash of known bytes never changes: caches rest on it") {
    const std::string text = "RayNest scene";
    CHECK(content_hash(std::as_bytes(std::span(text))) == "e582086dcea7463a4730dd0128706384");
}
