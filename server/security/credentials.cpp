#include "server/security/credentials.h"

#include "server/ground/log.h"

#include <utility>

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

Credentials::Files Credentials::read(const SecurityOptions& options) {
    Files files = read_tokens(options);
    files.tls_ = tls_of(options);
    return files;
}

Credentials::Files Credentials::read_tokens(const SecurityOptions& options) {
    Files files;
    files.options_ = options;
    files.tokens_ = tokens_of(options);
    return files;
}

Result<void> Credentials::load() {
    Files files = read(options_);
    if (!*files.tls_) return tl::unexpected(files.tls_->error());
    if (!files.tokens_) return tl::unexpected(files.tokens_.error());
    return take(std::move(files));
}

Result<void> Credentials::take(Files files) {
    // A token file alone changes no options; a reload has changed them meanwhile, and read its own.
    if (!files.tls_ && files.options_ != options_) return {};
    if (files.tls_) files.tls_ = logged(std::move(*files.tls_), "certificate_unusable");
    files.tokens_ = logged_once(std::move(files.tokens_));
    Result<void> done;
    if (files.tls_ && !*files.tls_)
        done = tl::unexpected(files.tls_->error());
    else if (!files.tokens_)
        done = tl::unexpected(files.tokens_.error());
    if (files.options_ != options_) {
        if (!done) return done;
        options_ = std::move(files.options_);
        authentication_.set_policy(policy_of(options_));
    }
    if (files.tls_ && *files.tls_) take(std::move(**files.tls_));
    if (files.tokens_) take(std::move(*files.tokens_));
    return done;
}

Result<Credentials::Tls> Credentials::tls_of(const SecurityOptions& options) {
    if (options.tls.certificate.empty()) return Tls();
    return TlsContext::load(options.tls);
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

Result<Credentials::Tokens> Credentials::tokens_of(const SecurityOptions& options) {
    if (options.tokens.empty()) return Tokens();
    const Version version = version_of(options.tokens);
    auto table = TokenTable::read(options.tokens, Reader::daemon);
    if (!table) return tl::unexpected(table.error());
    if (version != version_of(options.tokens))
        return fail(ErrorCode::io_failed,
                    options.tokens.string() + " changed while it was read, and is read again");
    return Tokens{std::make_shared<const TokenTable>(std::move(*table)), version};
}

void Credentials::take(Tokens tokens) {
    tokens_version_ = tokens_seen_ = tokens.version;
    dispose_(authentication_.set_tokens(std::move(tokens.table)));
    next_expiry_ = authentication_.tokens().next_expiry(WallClock::now());
}

Result<Credentials::Tokens> Credentials::logged_once(Result<Tokens> tokens) {
    const std::string reason = tokens ? "" : tokens.error().message;
    if (std::exchange(tokens_reason_, reason) == reason) return tokens;
    return logged(std::move(tokens), "tokens_unusable");
}

bool Credentials::tokens_changed() {
    if (options_.tokens.empty()) return false;
    const Version now = version_of(options_.tokens);
    // A program that writes in place, as scp does, empties the file first; it is to have ended.
    const bool is_whole =
        now == std::exchange(tokens_seen_, now) || now.file != tokens_version_.file;
    return is_whole && (now != tokens_version_ || !tokens_reason_.empty());
}

bool Credentials::any_expired(WallClock::time_point now) {
    const bool certificates = authentication_.certificates_ended(now);
    if (now < next_expiry_) return certificates;
    next_expiry_ = authentication_.tokens().next_expiry(now);
    return true;
}

}  // namespace raynest::server
