// Tests that the io thread's work with tokens does not grow with their number.
#include "server/security/credentials.h"
#include "tests/sanitized.h"
#include "tests/temporary_folder.h"
#include "tests/unit/server/counted_memory.h"

#include <doctest/doctest.h>
#include <malloc.h>

#include <cstdint>
#include <cstdlib>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace raynest::test {
namespace {

/// Bytes that the program has from malloc().
std::int64_t heap_now() {
    const struct mallinfo2 now = mallinfo2();
    return static_cast<std::int64_t>(now.uordblks + now.hblkhd);
}

/// A turn that takes tokens may allocate and free so much: a row is larger than 200 bytes.
constexpr std::int64_t taking_bytes_max = 64 << 10;

TEST_CASE("tokens are read elsewhere, and taken and looked for in a turn however many they are") {
    if (sanitized) return;
    using namespace server;
    constexpr int many = 5'000;
    const TemporaryFolder folder;
    SecurityOptions options;
    options.tokens = folder.path() / "tokens";
    const auto write = [&](int rows) {
        TokenTable table;
        for (int i = 0; i < rows; ++i) {
            const std::string name = "t" + std::to_string(i);
            table.put({TokenRow::Kind::token, name, Role::user, hash_token(name), {}, {}});
        }
        REQUIRE(table.write(options.tokens));
    };
    write(many);
    std::vector<std::shared_ptr<const void>> disposed;
    Credentials credentials(options);
    credentials.set_disposal([&](auto rows) { disposed.push_back(std::move(rows)); });
    REQUIRE(credentials.load());
    Authentication& daemon = credentials.authentication();
    write(many - 1);
    Credentials::Files files = Credentials::read_tokens(options);
    const std::int64_t heap_before = heap_now();
    const std::uint64_t allocated_before = allocated_bytes;
    CHECK(credentials.tokens_changed());
    CHECK(credentials.take(std::move(files)));
    CHECK_FALSE(credentials.any_expired({}));
    CHECK(daemon.tokens().find_token("t9", {}) != nullptr);
    CHECK(daemon.tokens().find_token("t" + std::to_string(many - 1), {}) == nullptr);
    CHECK(allocated_bytes - allocated_before <= taking_bytes_max);
    CHECK(std::abs(heap_now() - heap_before) <= taking_bytes_max);
    CHECK(disposed.size() == 2);  // the empty one before, and the first
}

}  // namespace
}  // namespace raynest::test
