#include "engine/scene/digest.h"

#include <fmt/format.h>
#include <openssl/evp.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <vector>

namespace raynest {
namespace {

constexpr std::size_t piece_bytes = 1 << 20;

using Sha256 = std::array<unsigned char, 32>;

[[nodiscard]] bool hash(std::span<const std::byte> bytes, Sha256& digest) {
    return EVP_Digest(bytes.data(), bytes.size(), digest.data(), nullptr, EVP_sha256(), nullptr) ==
           1;
}

}  // namespace

Result<std::string> scene_digest(std::span<const std::byte> arena) {
    std::vector<Sha256> pieces((arena.size() + piece_bytes - 1) / piece_bytes);
    std::atomic<bool> failed = false;
    tbb::parallel_for(std::size_t{0}, pieces.size(), [&](std::size_t i) {
        const auto rest = arena.subspan(i * piece_bytes);
        if (!hash(rest.first(std::min(rest.size(), piece_bytes)), pieces[i])) failed = true;
    });
    Sha256 whole;
    if (failed || !hash(std::as_bytes(std::span(pieces)), whole))
        return fail(
            ErrorCode::internal,
            "libcrypto computes no SHA-256: check the OpenSSL configuration (OPENSSL_CONF)");
    return fmt::format("{:02x}", fmt::join(whole, ""));
}

}  // namespace raynest
