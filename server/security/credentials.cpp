#include "server/security/credentials.h"

#include "server/log.h"

#include <algorithm>

namespace raynest::server {
namespace {

/// Logs a failure, and returns what it is given.
Result<void> logged(Result<void> done, const char* event) {
    if (!done) log(LogLevel::error, event, {{"reason", done.error().message}, {"kept", "old"}});
    return done;
}

}  // namespace

Credentials::Credentials(const SecurityOptions& options, const protocol::Limits& limits)
    : options_(options),
      authentication_(policy_of(options), limits) {}

AccessPolicy Credentials::policy_of(const SecurityOptions& options) {
    return {options.anonymous, !options.tokens.empty(), !options.tls.client_ca.empty()};
}

std::optional<double> Credentials::certificate_days_left(WallClock::time_point now) const {
    if (tls_ == nullptr) return std::nullopt;
    return std::chrono::duration<double, std::chrono::days::period>(tls_->expires() - now).count();
}

Credentials::Version Credentials::version_of(const std::filesystem::path& file) {
    struct stat status {};
    if (stat(file.c_str(), &status) != 0) return {};
    return {status.st_dev, status.st_ino, status.st_size,
            static_cast<std::int64_t>(status.st_ctim.tv_sec) * 1'000'000'000 +
                status.st_ctim.tv_nsec};
}

Result<void> Credentials::load() {
    if (auto done = load_tls(); !done) return done;
    return load_tokens();
}

Result<void> Credentials::reload(const SecurityOptions& options) {
    options_ = options;
    authentication_.set_policy(policy_of(options));
    const auto tls = logged(load_tls(), "certificate_unusable");
    const auto tokens = logged(load_tokens(), "tokens_unusable");
    return tls ? tokens : tls;
}

Result<void> Credentials::load_tls() {
    if (options_.tls.certificate.empty()) return {};
    auto context = TlsContext::load(options_.tls);
    if (!context) return tl::unexpected(context.error());
    tls_ = std::move(*context);
    const auto left = tls_->expires() - WallClock::now();
    constexpr int warn_days = 30;
    const auto days = std::chrono::floor<std::chrono::days>(left).count();
    if (days < warn_days)
        log(LogLevel::warn, "certificate_expires",
            {{"days_left", std::to_string(days)}, {"remedy", "raynestd tls renew DIR, then SIGHUP"}});
    return {};
}

Result<void> Credentials::load_tokens() {
    if (options_.tokens.empty()) return {};
    // Take the version first: a change during the read is seen by the next look.
    tokens_version_ = version_of(options_.tokens);
    auto table = TokenTable::read(options_.tokens, Reader::daemon);
    if (!table) return tl::unexpected(table.error());
    next_expiry_ = WallClock::time_point::max();
    const auto now = WallClock::now();
    for (const TokenRow& row : table->rows())
        if (row.expires && *row.expires > now) next_expiry_ = std::min(next_expiry_, *row.expires);
    authentication_.set_tokens(std::move(*table));
    return {};
}

bool Credentials::look_at_tokens(WallClock::time_point now) {
    if (options_.tokens.empty()) return false;
    if (version_of(options_.tokens) != tokens_version_) {
        const bool good = logged(load_tokens(), "tokens_unusable").has_value();
        if (good)
            log(LogLevel::info, "tokens_read",
                {{"rows", std::to_string(authentication_.tokens().rows().size())}});
        return good;
    }
    if (now < next_expiry_) return false;
    (void)load_tokens();
    return true;
}

}  // namespace raynest::server
