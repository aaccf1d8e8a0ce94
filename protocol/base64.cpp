#include "protocol/base64.h"

#include "protocol/openssl.h"

#include <algorithm>

namespace raynest::protocol {
namespace {

/// OpenSSL counts in int. A multiple of 3 and of 4.
constexpr std::size_t bytes_at_once = 12U << 20;

unsigned char* unsigned_bytes(void* bytes) {
    return static_cast<unsigned char*>(bytes);
}
const unsigned char* unsigned_bytes(const void* bytes) {
    return static_cast<const unsigned char*>(bytes);
}

}  // namespace

std::string to_base64(std::span<const std::byte> bytes) {
    std::string text(base64_length(bytes.size()) + 1, '\0');  // OpenSSL ends its text by a zero
    for (std::size_t at = 0; at < bytes.size(); at += bytes_at_once) {
        const auto part = bytes.subspan(at, std::min(bytes_at_once, bytes.size() - at));
        EVP_EncodeBlock(unsigned_bytes(text.data() + at / 3 * 4), unsigned_bytes(part.data()),
                        static_cast<int>(part.size()));
    }
    text.pop_back();
    return text;
}

std::optional<std::vector<std::byte>> from_base64(std::string_view text) {
    // OpenSSL takes padding for letters, and passes over blanks at both ends.
    const std::size_t padding = text.size() - std::min(text.find('='), text.size());
    if (text.size() % 4 != 0 || padding > 2 || (padding == 2 && text.back() != '='))
        return std::nullopt;
    std::vector<std::byte> bytes(text.size() / 4 * 3);
    for (std::size_t at = 0; at < text.size(); at += bytes_at_once) {
        const std::string_view part = text.substr(at, bytes_at_once);
        const int length = static_cast<int>(part.size());
        if (EVP_DecodeBlock(unsigned_bytes(bytes.data() + at / 4 * 3), unsigned_bytes(part.data()),
                            length) != length / 4 * 3)
            return std::nullopt;
    }
    bytes.resize(bytes.size() - padding);
    return bytes;
}

}  // namespace raynest::protocol
