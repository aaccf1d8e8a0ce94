#include "engine/scene/digest.h"

#include <fmt/format.h>
#include <openssl/evp.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>

namespace raynest {

bool hash_bytes(std::span<const std::byte> bytes, Sha256& digest) {
    return EVP_Digest(bytes.data(), bytes.size(), digest.data(), nullptr, EVP_sha256(), nullptr) ==
           1;
}

tl::unexpected<Error> no_sha256() {
    return fail(ErrorCode::internal,
                "libcrypto computes no SHA-256: check the OpenSSL configuration (OPENSSL_CONF)");
}

bool hash_pieces(std::span<const std::byte> bytes, Sha256& digest) {
    std::vector<Sha256> pieces((bytes.size() + digest_piece_bytes - 1) / digest_piece_bytes);
    std::atomic<bool> failed = false;
    tbb::parallel_for(std::size_t{0}, pieces.size(), [&](std::size_t i) {
        const auto rest = bytes.subspan(i * digest_piece_bytes);
        if (!hash_bytes(rest.first(std::min(rest.size(), digest_piece_bytes)), pieces[i]))
            failed = true;
    });
    return !failed && hash_bytes(std::as_bytes(std::span(pieces)), digest);
}

std::string digest_text(const Sha256& digest) {
    return fmt::format("{:02x}", fmt::join(digest, ""));
}

Result<std::string> arena_digest(std::span<const std::byte> arena) {
    Sha256 whole;
    if (!hash_pieces(arena, whole)) return no_sha256();
    return digest_text(whole);
}

}  // namespace raynest
