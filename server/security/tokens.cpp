#include "server/security/tokens.h"

#include "protocol/validate.h"
#include "server/ground/size.h"

#include <openssl/evp.h>
#include <openssl/rand.h>

#include <algorithm>
#include <charconv>
#include <new>
#include <sstream>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::size_t file_bytes_max = 4 << 20;
constexpr std::size_t name_bytes_max = 64;
/// The year 2255, in seconds: later times do not fit a clock of nanoseconds.
constexpr std::int64_t expires_max = 9'000'000'000;
/// The words of TokenRow::Kind in the file.
constexpr std::array<std::string_view, 3> kind_names = {"token", "cert", "shut"};
constexpr std::string_view digits = "0123456789abcdef";

std::string to_hex(const TokenHash& bytes) {
    std::string text;
    for (const unsigned char byte : bytes) {
        text += digits[byte >> 4];
        text += digits[byte & 15];
    }
    return text;
}

std::optional<TokenHash> from_hex(std::string_view text) {
    TokenHash bytes{};
    if (text.size() != 2 * bytes.size()) return std::nullopt;
    for (std::size_t i = 0; i < bytes.size(); ++i) {
        const char* first = text.data() + 2 * i;
        const auto [end, error] = std::from_chars(first, first + 2, bytes[i], 16);
        if (error != std::errc{} || end != first + 2) return std::nullopt;
    }
    return bytes;
}

template <class Number>
std::optional<Number> to_number(std::string_view text) {
    Number number{};
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
    return number;
}

struct QuotaField {
    std::string_view name;
    std::uint64_t Quota::*value;
    [[nodiscard]] bool is_bytes() const { return name.ends_with("bytes"); }
};
constexpr std::array quota_fields = {
#define RAYNEST_QUOTA(key, least) QuotaField{#key, &Quota::key},
#include "protocol/lists/quotas.def"
};

/// Parses a row; the error text of an invalid one has no line number.
tl::expected<TokenRow, std::string> to_row(const std::string& line) {
    std::istringstream words(line);
    std::string kind, role, expires, quota, hash;
    TokenRow row;
    words >> kind >> role >> expires >> quota >> hash >> std::ws;
    std::getline(words, row.name);
    if (row.name.empty()) return tl::unexpected<std::string>("it has fewer than six fields");
    const auto* const known_kind = std::ranges::find(kind_names, kind);
    if (known_kind == kind_names.end())
        return tl::unexpected("'" + kind + "' is neither token nor cert nor shut");
    row.kind = static_cast<TokenRow::Kind>(known_kind - kind_names.begin());
    const auto known_role = parse_role(role);
    if (!known_role) return tl::unexpected("'" + role + "' is not a role: viewer, user or admin");
    row.role = *known_role;
    if (expires != "never") {
        const auto seconds = to_number<std::int64_t>(expires);
        if (!seconds || *seconds < 0 || *seconds > expires_max)
            return tl::unexpected("'" + expires + "' is neither a Unix time nor never");
        row.expires = WallClock::time_point(std::chrono::seconds(*seconds));
    }
    const auto known_quota = parse_quota(quota == "-" ? "" : quota);
    if (!known_quota) return tl::unexpected("'" + quota + "' is not a quota");
    row.quota = *known_quota;
    if (row.kind == TokenRow::Kind::token) {
        const auto known_hash = from_hex(hash);
        if (!known_hash) return tl::unexpected<std::string>("its hash has not 64 hex digits");
        row.hash = *known_hash;
        if (!is_token_name(row.name)) return tl::unexpected("'" + row.name + "' is not a name");
    }
    return row;
}

bool is_valid_at(const TokenRow& row, WallClock::time_point now) {
    return !row.expires || now < *row.expires;
}

}  // namespace

std::string new_secret() {
    TokenHash bytes{};
    // Without random numbers no secret is better than one that can be guessed.
    if (RAND_bytes(bytes.data(), static_cast<int>(bytes.size())) != 1) throw std::bad_alloc();
    return to_hex(bytes);
}

std::string new_token() {
    return "rnt_" + new_secret();
}

TokenHash hash_token(std::string_view token) {
    TokenHash hash{};
    if (EVP_Digest(token.data(), token.size(), hash.data(), nullptr, EVP_sha256(), nullptr) != 1)
        throw std::bad_alloc();
    return hash;
}

bool is_token_name(std::string_view name) {
    const auto is_letter = [](char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); };
    return !name.empty() && name.size() <= name_bytes_max && is_letter(name.front()) &&
           std::ranges::all_of(name, [&](char c) {
               return is_letter(c) || (c >= '0' && c <= '9') || c == '-' || c == '.' || c == '_';
           });
}

std::optional<Quota> parse_quota(std::string_view text) {
    Quota quota;
    while (!text.empty()) {
        const std::string_view part = text.substr(0, text.find(','));
        text.remove_prefix(std::min(text.size(), part.size() + 1));
        const std::size_t equals = part.find('=');
        if (equals == std::string_view::npos) return std::nullopt;
        const auto field =
            std::ranges::find(quota_fields, part.substr(0, equals), &QuotaField::name);
        if (field == quota_fields.end()) return std::nullopt;
        const std::string_view number = part.substr(equals + 1);
        const auto value =
            field->is_bytes() ? parse_size(number) : to_number<std::uint64_t>(number);
        if (!value || *value == 0) return std::nullopt;
        quota.*field->value = *value;
    }
    return quota;
}

std::string to_text(const Quota& quota) {
    std::string text;
    for (const QuotaField& field : quota_fields) {
        if (quota.*field.value == 0) continue;
        if (!text.empty()) text += ',';
        text.append(field.name).append("=").append(std::to_string(quota.*field.value));
    }
    return text;
}

Result<TokenTable> TokenTable::parse(std::string_view content) {
    TokenTable table;
    std::istringstream lines{std::string(content)};
    std::string line;
    for (std::size_t number = 1; std::getline(lines, line); ++number) {
        const std::size_t first = line.find_first_not_of(" \t\r");
        if (first == std::string::npos || line[first] == '#') continue;
        const auto refuse = [&](const std::string& why) {
            return fail(ErrorCode::param_invalid, "line " + std::to_string(number) + ": " + why);
        };
        if (!protocol::printable(line)) return refuse("it is not printable text");
        auto row = to_row(line);
        if (!row) return refuse(row.error());
        if (table.find_name(row->name) != nullptr)
            return refuse("'" + row->name + "' has a row above; keep one of them");
        table.add(std::move(*row));
    }
    return table;
}

Result<TokenTable> TokenTable::parse_file(const std::filesystem::path& file,
                                          const Result<std::string>& content) {
    if (!content) return tl::unexpected(content.error());
    auto table = parse(*content);
    if (!table) table.error().message = file.string() + ", " + table.error().message;
    return table;
}

Result<TokenTable> TokenTable::read(const std::filesystem::path& file, Reader reader) {
    return parse_file(file, read_secret_file(file, file_bytes_max, reader));
}

Result<TokenTable> TokenTable::read_to_edit(const FilePlace& place) {
    if (!place.exists()) return TokenTable();
    return parse_file(place.path(), read_secret_file(place, file_bytes_max, Reader::command));
}

Result<void> TokenTable::write(const FilePlace& place) const {
    const std::string text = to_text();
    const std::string file = place.path().string();
    if (text.size() > file_bytes_max)
        return fail(ErrorCode::limit_exceeded, file + " would be over " +
                                                   std::to_string(file_bytes_max) +
                                                   " bytes; revoke tokens that nobody uses");
    const auto same = parse(text);
    if (!same || same->rows() != rows_)
        return fail(ErrorCode::param_invalid, file + " would become unusable, and stays as it was" +
                                                  (same ? "" : ": " + same.error().message));
    return write_files_atomically({{place, text}});
}

Result<void> TokenTable::write(const std::filesystem::path& file) const {
    const auto place = FilePlace::find(file);
    return place ? write(*place) : tl::unexpected(place.error());
}

std::string TokenTable::to_text() const {
    std::string text =
        "# Tokens of raynestd, written by `raynestd token`: kind role expires quota hash name\n";
    for (const TokenRow& row : rows_) {
        const bool is_token = row.kind == TokenRow::Kind::token;
        const std::string quota = server::to_text(row.quota);
        text.append(kind_names[static_cast<std::size_t>(row.kind)]).append(" ");
        text.append(role_name(row.role)).append(" ");
        text += row.expires ? std::to_string(WallClock::to_time_t(*row.expires)) : "never";
        text += " " + (quota.empty() ? "-" : quota) + " " + (is_token ? to_hex(row.hash) : "-") +
                " " + row.name + "\n";
    }
    return text;
}

const TokenRow* TokenTable::find_token(std::string_view token, WallClock::time_point now) const {
    // The last valid one of rows for the same token counts.
    const TokenRow* found = nullptr;
    const auto [first, end] = by_hash_.equal_range(hash_token(token));
    for (auto at = first; at != end; ++at)
        if (const TokenRow& row = rows_[at->second]; is_valid_at(row, now)) found = &row;
    return found;
}

const TokenRow* TokenTable::find_name(std::string_view name) const {
    const auto found = by_name_.find(name);
    return found == by_name_.end() ? nullptr : &rows_[found->second];
}

WallClock::time_point TokenTable::next_expiry(WallClock::time_point now) const {
    const auto next = expiries_.upper_bound(now);
    return next == expiries_.end() ? WallClock::time_point::max() : *next;
}

void TokenTable::add(TokenRow row) {
    const std::size_t place = rows_.size();
    by_name_.emplace(row.name, place);
    if (row.kind == TokenRow::Kind::token) by_hash_.emplace(row.hash, place);
    if (row.expires) expiries_.insert(*row.expires);
    rows_.push_back(std::move(row));
}

void TokenTable::put(TokenRow row) {
    erase(row.name);
    add(std::move(row));
}

bool TokenTable::erase(std::string_view name) {
    if (find_name(name) == nullptr) return false;
    for (TokenRow& row : std::exchange(*this, {}).rows_)
        if (row.name != name) add(std::move(row));
    return true;
}

}  // namespace raynest::server
