// OpenSSL as both ends need it: owners of what it has made, its errors in words, and the digest
// by which a client asks whether the daemon has a scene already.
#pragma once

#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/sslerr.h>

#include <array>
#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <string>

namespace raynest::protocol {

/// A deleter: std::unique_ptr<SSL, Release<SSL_free>>.
template <auto release>
struct Release {
    template <class T>
    void operator()(T* owned) const {
        release(owned);
    }
};

/// Returns the first error of OpenSSL in this thread as words, and clears them all. `unknown`
/// stands for an error without words.
inline std::string openssl_error_text(const char* unknown) {
    const unsigned long code = ERR_get_error();
    ERR_clear_error();
    if (ERR_GET_LIB(code) == ERR_LIB_SSL) switch (ERR_GET_REASON(code)) {
            case SSL_R_EE_KEY_TOO_SMALL:
                return "its key is too short to be safe: RSA needs 2048 bits";
            case SSL_R_CA_KEY_TOO_SMALL:
                return "the key of its CA is too short to be safe: RSA needs 2048 bits";
            case SSL_R_CA_MD_TOO_WEAK:
                return "it is signed with an unsafe hash: sign it with SHA-256";
            default:
                break;
        }
    const char* reason = code == 0 ? nullptr : ERR_reason_error_string(code);
    return reason == nullptr ? unknown : reason;
}

using Sha256Digest = std::array<unsigned char, 32>;

/// Takes bytes in parts. OpenSSL may be configured without SHA-256: there is no digest then.
class Sha256 {
public:
    Sha256()
        : good_(context_ != nullptr &&
                EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr) == 1) {}
    void add(std::span<const std::byte> bytes) {
        good_ = good_ && EVP_DigestUpdate(context_.get(), bytes.data(), bytes.size()) == 1;
    }
    /// Ends the input.
    [[nodiscard]] std::optional<Sha256Digest> digest() {
        Sha256Digest out{};
        if (!good_ || EVP_DigestFinal_ex(context_.get(), out.data(), nullptr) != 1)
            return std::nullopt;
        return out;
    }

private:
    std::unique_ptr<EVP_MD_CTX, Release<EVP_MD_CTX_free>> context_{EVP_MD_CTX_new()};
    bool good_ = false;
};

}  // namespace raynest::protocol
