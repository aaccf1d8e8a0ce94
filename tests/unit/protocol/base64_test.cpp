#include "protocol/base64.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstddef>
#include <span>
#include <string>
#include <vector>

using namespace raynest::protocol;

TEST_CASE("bytes come back from Base64, whatever their number") {
    // The examples of RFC 4648.
    const std::string text = "foobar";
    const char* encoded[] = {"", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"};
    for (std::size_t size = 0; size <= text.size(); ++size) {
        const auto bytes = std::as_bytes(std::span(text.data(), size));
        CHECK(to_base64(bytes) == encoded[size]);
        CHECK(base64_length(size) == std::string(encoded[size]).size());
        const auto back = from_base64(encoded[size]);
        REQUIRE(back.has_value());
        CHECK(std::equal(back->begin(), back->end(), bytes.begin(), bytes.end()));
    }
    std::vector<std::byte> all(256);
    for (std::size_t i = 0; i < all.size(); ++i) all[i] = static_cast<std::byte>(i);
    CHECK(from_base64(to_base64(all)) == all);
    // More than are encoded and decoded at once.
    all.resize((13U << 20) + 1, std::byte{0x5A});
    CHECK(from_base64(to_base64(all)) == all);
}

TEST_CASE("what is no Base64 is refused") {
    for (const char* text :
         {"Z", "Zg=", "Zg", "====", "Z===", "Zg==Zg==", "Zm9\n", "Zm9-", "Zm_v", "=m9v", "Z=9v",
          "Zm=v", "Zm9v    ", "    Zm9v", "Zm9v\n\n\n\n", "Zm9v----"})
        CHECK_FALSE(from_base64(text).has_value());
}
