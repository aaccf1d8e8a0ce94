// What both ends of TLS need of OpenSSL: owners of what it has made, and its errors in words.
#pragma once

#include <openssl/err.h>
#include <openssl/sslerr.h>

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

/// Returns the first error of OpenSSL in this thread as words, and clears them all. `unknown` stands
/// for an error without words.
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

}  // namespace raynest::protocol
