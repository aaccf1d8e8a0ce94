// Ids that name a request in the log of the daemon and in the errors of its client alike.
//
// A connection counts its requests up from a random number, so that an id is found once in a log.
#pragma once

#include <array>
#include <charconv>
#include <cstdint>
#include <random>
#include <string>

namespace raynest::protocol {

/// Returns the id before a connection's first request: 32 random bits and room for 65,535 requests.
/// JavaScript's numbers still hold it.
[[nodiscard]] inline std::uint64_t first_request_id() {
    std::random_device random;
    return static_cast<std::uint64_t>(random() & 0xFFFFFFFFU) << 16;
}

/// Returns the text of an id, in hexadecimal digits.
[[nodiscard]] inline std::string request_text(std::uint64_t id) {
    std::array<char, 16> digits{};
    const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), id, 16).ptr;
    return {digits.data(), end};
}

}  // namespace raynest::protocol
