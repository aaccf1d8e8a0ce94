// The token file: who may connect, and in which role.
//
// One row per line, fields separated by blanks, '#' begins a comment line:
//   token ROLE EXPIRES QUOTA HASH NAME      HASH: SHA-256 of the token, 64 hex digits
//   cert  ROLE EXPIRES QUOTA -    SUBJECT   SUBJECT of a client certificate, "CN=robot,O=Lab"
//   shut  ROLE EXPIRES QUOTA -    SUBJECT   a certificate that is not let in, though its CA is trusted
// EXPIRES is a Unix time or `never`, QUOTA is `jobs=8,rays=1000000` or `-`. The tokens themselves
// are not in the file: reading it lets nobody in.
#pragma once

#include "engine/result.h"
#include "server/security/principal.h"
#include "server/security/secret_file.h"

#include <array>
#include <chrono>
#include <cstddef>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

using WallClock = std::chrono::system_clock;
using TokenHash = std::array<unsigned char, 32>;

/// A row of the token file.
struct TokenRow {
    enum class Kind { token, certificate, shut_out };
    Kind kind = Kind::token;
    std::string name;  ///< the principal: a token's name or a certificate's subject
    Role role = Role::viewer;
    TokenHash hash{};                              ///< all zeros but for a token
    std::optional<WallClock::time_point> expires;  ///< empty: never
    Quota quota;

    bool operator==(const TokenRow&) const = default;
};

/// Returns 256 random bits as 64 hex digits.
[[nodiscard]] std::string new_secret();
/// Returns a new token: "rnt_" and a secret.
[[nodiscard]] std::string new_token();
[[nodiscard]] TokenHash hash_token(std::string_view token);

/// True for a name of 1 to 64 letters, digits and -._ that begins with a letter: no address or uid
/// can be mistaken for one.
[[nodiscard]] bool is_token_name(std::string_view name);

/// Parses "jobs=8,rays=1000000,scene_bytes=20G,connections=…,second_bytes=…"; size.h has the sizes.
/// Returns nothing if a part is invalid.
[[nodiscard]] std::optional<Quota> parse_quota(std::string_view text);
[[nodiscard]] std::string to_text(const Quota& quota);

/// The rows of a token file. Immutable once read.
class TokenTable {
public:
    /// Parses the content of a file; errors name the line.
    static Result<TokenTable> parse(std::string_view content);
    /// Reads a file as read_secret_file() does.
    static Result<TokenTable> read(const std::filesystem::path& file, Reader reader);
    /// Reads a file for a command that writes it again. A file that does not exist has no rows.
    static Result<TokenTable> read_to_edit(const FilePlace& place);
    /// Replaces a file. Fails, and changes nothing, if read() would refuse the new content.
    [[nodiscard]] Result<void> write(const FilePlace& place) const;
    [[nodiscard]] Result<void> write(const std::filesystem::path& file) const;
    [[nodiscard]] std::string to_text() const;

    /// Returns the row of a token, null if there is none or it has expired. The time tells at most
    /// how a hash begins, which helps nobody to find its token.
    [[nodiscard]] const TokenRow* find_token(std::string_view token,
                                             WallClock::time_point now) const;
    [[nodiscard]] const TokenRow* find_name(std::string_view name) const;
    /// Returns when the next row after `now` expires; max if none does.
    [[nodiscard]] WallClock::time_point next_expiry(WallClock::time_point now) const;

    [[nodiscard]] const std::vector<TokenRow>& rows() const { return rows_; }
    /// Adds a row, or replaces the one of the same name.
    void put(TokenRow row);
    /// False if there is no such row.
    bool erase(std::string_view name);

private:
    static Result<TokenTable> parse_file(const std::filesystem::path& file,
                                         const Result<std::string>& content);

    void add(TokenRow row);

    // A file may have tens of thousands of rows, and the io thread looks for one with each Hello.
    std::vector<TokenRow> rows_;
    std::map<std::string, std::size_t, std::less<>> by_name_;  ///< places in rows_
    std::multimap<TokenHash, std::size_t> by_hash_;            ///< the same of tokens alone
    std::set<WallClock::time_point> expiries_;
};

}  // namespace raynest::server
