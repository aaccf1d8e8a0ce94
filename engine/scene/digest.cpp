#include "engine/scene/digest.h"

#include <fmt/format.h>
#include <openssl/evp.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>

namespace raynest {
namespace {

[[nodiscard]] bool hash(std::span<const std::byte> bytes, Sha256& digest) {
    return EVP_Digest(bytes.data(), bytes.size(), digest.data(), nullptr, EVP_sha256(), nullptr) ==
           1;
}

tl::unexpected<Error> no_sha256() {
    return fail(ErrorCode::internal,
                "libcrypto computes no SHA-256: check the OpenSSL configuration (OPENSSL_CONF)");
}

}  // namespace

Result<void> hash_pieces(std::span<const std::byte> arena, const std::vector<bool>& stale,
                         std::vector<Sha256>& pieces) {
    std::atomic<bool> failed = false;
    tbb::parallel_for(std::size_t{0}, pieces.size(), [&](std::size_t i) {
        if (!stale[i]) return;
        const auto rest = arena.subspan(i * digest_piece_bytes);
        if (!hash(rest.first(std::min(rest.size(), digest_piece_bytes)), pieces[i])) failed = true;
    });
    if (failed) return no_sha256();
    return {};
}

Result<std::string> scene_digest(std::span<const Sha256> pieces) {
    Sha256 whole;
    if (!hash(std::as_bytes(pieces), whole)) return no_sha256();
    return fmt::format("{:02x}", fmt::join(whole, ""));
}

Result<std::string> scene_digest(std::span<const std::byte> arena) {
    std::vector<Sha256> pieces((arena.size() + digest_piece_bytes - 1) / digest_piece_bytes);
    if (auto hashed = hash_pieces(arena, std::vector<bool>(pieces.size(), true), pieces); !hashed)
        return tl::unexpected(hashed.error());
    return scene_digest(pieces);
}

}  // namespace raynest
