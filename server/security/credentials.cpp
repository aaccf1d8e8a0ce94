#include "server/security/credentials.h"

#include "server/ground/log.h"
#include "server/security/file_place.h"

#include <algorithm>

namespace raynest::server {
namespace {

/// Logs a failure, and returns what it is given.
template <class Value>
Result<Value> logged(Result<Value> done, const char* event) {
    if (!done) log(LogLevel::error, event, {{"reason", done.error().message}, {"kept", "old"}});
    return done;
}

}  // namespace

AccessPolicy policy_of(const SecurityOptions& options) {
    return {options.anonymous, !options.tokens.empty(), !options.tls.client_ca.empty()};
}

Credentials::Credentials(const SecurityOptions& options, const protocol::Limits& limits,
                         Metrics::Counter* refused)
    : options_(options),
      authentication_(policy_of(options), limits, refused) {
    authentication_.set_trust([this](const ClientCertificate& shown, WallClock::time_point now) {
        return tls_ != nullptr && tls_->trusts(shown, now);
    });
}

std::optional<double> Credentials::certificate_days_left(WallClock::time_point now) const {
    if (tls_ == nullptr) return std::nullopt;
    return std::chrono::duration<double, std::chrono::days::period>(tls_->expires() - now).count();
}

Credentials::Version Credentials::version_of(const std::filesystem::path& file) {
    struct stat status {};
    if (stat(file.c_str(), &status) != 0) return {};
    return {
        status.st_dev, status.st_ino, status.st_size,
        static_cast<std::int64_t>(status.st_ctim.tv_sec) * 1'000'000'000 + status.st_ctim.tv_nsec};
}

Result<void> Credentials::load() {
    auto tls = read_tls(options_);
    if (!tls) return tl::unexpected(tls.error());
    auto tokens = read_tokens(options_);
    if (!tokens) return tl::unexpected(tokens.error());
    take(std::move(*tls));
    take(std::move(*tokens));
    return {};
}

Result<void> Credentials::reload(const SecurityOptions& options) {
    auto tls = logged(read_tls(options), "certificate_unusable");
    auto tokens = logged(read_tokens(options), "tokens_unusable");
    Result<void> done;
    if (!tls)
        done = tl::unexpected(tls.error());
    else if (!tokens)
        done = tl::unexpected(tokens.error());
    if (!done && options != options_) {
        (void)reload(options_);
        return done;
    }
    options_ = options;
    if (tls) take(std::move(*tls));
    if (tokens) take(std::move(*tokens));
    authentication_.set_policy(policy_of(options_));
    return done;
}

Result<Credentials::Tls> Credentials::read_tls(const SecurityOptions& options) {
    if (options.tls.certificate.empty()) return Tls();
    auto tls = TlsContext::load(options.tls);
    if (!tls) return tls;
    for (const auto& file : {options.tls.certificate, options.tls.key, options.tls.client_ca})
        if (std::string why = file.empty() ? "" : place_fault(file, "let in whom they like");
            !why.empty())
            return file_failed(file, why);
    return tls;
}

void Credentials::take(Tls tls) {
    tls_ = std::move(tls);
    if (tls_ == nullptr) return;
    const auto left = tls_->expires() - WallClock::now();
    constexpr int warn_days = 30;
    const auto days = std::chrono::floor<std::chrono::days>(left).count();
    if (days < warn_days)
        log(LogLevel::warn, "certificate_expires",
            {{"days_left", std::to_string(days)},
             {"remedy", "raynestd tls renew DIR, then SIGHUP"}});
}

Result<Credentials::Tokens> Credentials::read_tokens(const SecurityOptions& options) {
    if (options.tokens.empty()) return Tokens();
    // Take the version first: a change during the read is seen by the next look.
    const Version version = version_of(options.tokens);
    auto table = TokenTable::read(options.tokens, Reader::daemon);
    if (!table) return tl::unexpected(table.error());
    if (const std::string why = place_fault(options.tokens, "let in whom they like"); !why.empty())
        return file_failed(options.tokens, why);
    return Tokens{std::move(*table), version};
}

void Credentials::take(Tokens tokens) {
    tokens_version_ = tokens.version;
    authentication_.set_tokens(std::move(tokens.table));
    find_next_expiry(WallClock::now());
}

void Credentials::find_next_expiry(WallClock::time_point now) {
    next_expiry_ = WallClock::time_point::max();
    for (const TokenRow& row : authentication_.tokens().rows())
        if (row.expires && *row.expires > now) next_expiry_ = std::min(next_expiry_, *row.expires);
}

bool Credentials::look(WallClock::time_point now) {
    bool changed = authentication_.certificates_ended(now);
    if (now >= next_expiry_) {
        find_next_expiry(now);
        changed = true;
    }
    if (options_.tokens.empty()) return changed;
    const Version version = version_of(options_.tokens);
    if (version == tokens_version_) return changed;
    // Read each version once: an unusable one is logged once.
    tokens_version_ = version;
    auto tokens = logged(read_tokens(options_), "tokens_unusable");
    if (!tokens) return changed;
    take(std::move(*tokens));
    log(LogLevel::info, "tokens_read",
        {{"rows", std::to_string(authentication_.tokens().rows().size())}});
    return true;
}

}  // namespace raynest::server
