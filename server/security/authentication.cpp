#include "server/security/authentication.h"

#include "server/ground/limited_log.h"
#include "server/security/tls_context.h"

#include <algorithm>
#include <utility>

namespace raynest::server {
namespace {

using std::chrono::milliseconds;

/// Wrong tokens from one address before it must wait.
constexpr unsigned free_failures = 5;
constexpr milliseconds wait_min{250};
constexpr milliseconds wait_max{30'000};
constexpr std::chrono::minutes forgotten_after{10};
/// Addresses that are remembered; the one whose last failure is oldest is forgotten first.
constexpr std::size_t addresses_max = 4096;

constexpr const char* token_remedy =
    "set RAYNEST_TOKEN, pass --token-file FILE, or run: raynest login URI";

/// Identifies a row and its content, without its secret.
std::string credential_of(const TokenRow& row) {
    TokenTable table;
    table.put(row);
    return table.to_text();
}

Principal principal_of(const TokenRow& row, Admittance admittance) {
    return {row.name, row.quota, row.role, credential_of(row), 0, std::move(admittance)};
}

/// True if the row lets holders of this kind of credential in.
bool lets_in(const TokenRow& row, TokenRow::Kind kind, WallClock::time_point wall) {
    return row.kind == kind && (!row.expires || wall < *row.expires);
}

bool is_encrypted(std::string_view transport) {
    return transport == "tls" || transport == "https";
}

bool is_request(std::string_view transport) {
    return transport == "http" || transport == "https";
}

void audit_login(const PeerIdentity& peer, const std::string& principal, const char* by) {
    log_limited(LogLevel::info, "login", principal,
                {{"peer", peer.whereabouts()},
                 {"transport", peer.transport},
                 {"principal", principal},
                 {"reason", by}});
}

}  // namespace

milliseconds LoginFailures::wait_of(const std::string& address, Time now) const {
    const auto found = addresses_.find(address);
    if (found == addresses_.end() || found->second.failures < free_failures) return {};
    const unsigned doublings = std::min(found->second.failures - free_failures, 16U);
    const milliseconds wait = std::min(wait_min * (1U << doublings), wait_max);
    const auto left = std::chrono::ceil<milliseconds>(found->second.last + wait - now);
    return std::max(left, milliseconds(0));
}

void LoginFailures::failed(const std::string& address, Time now) {
    if (addresses_.size() >= addresses_max && !addresses_.contains(address))
        addresses_.erase(std::ranges::min_element(
            addresses_, {}, [](const auto& entry) { return entry.second.last; }));
    Entry& entry = addresses_[address];
    if (now - entry.last > forgotten_after) entry.failures = 0;
    ++entry.failures;
    entry.last = now;
}

Reply<Principal> Authentication::identify(const PeerIdentity& peer, std::string_view token,
                                          Time now, WallClock::time_point wall) {
    if (!token.empty() && policy_.tokens) return by_token(peer, token, now, wall, Audit::logins);
    if (peer.sender != nullptr) {
        if (!still_valid(*peer.sender, wall))
            return refuse(Code::not_allowed, "the login of this page has ended; open it again");
        audit_login(peer, peer.sender->id, "page");
        return *peer.sender;
    }
    if (!peer.subject.empty()) return by_certificate(peer, wall, Audit::logins);
    return anonymous(peer);
}

Reply<Principal> Authentication::identify_request(const PeerIdentity& peer, std::string_view bearer,
                                                  std::string_view cookie, Time now,
                                                  WallClock::time_point wall) {
    if (!bearer.empty() && policy_.tokens)
        return by_token(peer, bearer, now, wall, Audit::refusals);
    if (const Principal* known = logins_.find(cookie, wall);
        known != nullptr && still_valid(*known, wall))
        return *known;
    if (!peer.subject.empty()) return by_certificate(peer, wall, Audit::refusals);
    return anonymous(peer);
}

std::string Authentication::question_before(const PeerIdentity& peer, std::string_view code,
                                            std::string_view cookie,
                                            WallClock::time_point wall) const {
    const Principal* then = logins_.find_code(code, wall);
    if (then == nullptr || !still_valid(*then, wall)) return "";
    const Principal* known = logins_.find(cookie, wall);
    std::string now;
    if (known != nullptr && still_valid(*known, wall))
        now = known->id;
    else if (const auto holder = holder_of(peer.subject, peer.certificate, wall))
        now = holder->id;
    const std::string becomes = ", and the address logs it in as " + then->id;
    if (!now.empty()) return now == then->id ? "" : "this page is logged in as " + now + becomes;
    // Others may send an address whose code is theirs, to see what is loaded then. They have no code
    // of the daemon's own user.
    using Place = PeerIdentity::Place;
    const bool is_daemons_user = then->admittance.by == Admittance::By::transport &&
                                 then->admittance.place == Place::own_user;
    // A peer behind a proxy may have its name, and is not admitted as it.
    const bool is_same = then->id == peer.name && peer.subject.empty() &&
                         role_without(policy_, peer.place, peer.transport);
    return is_daemons_user || is_same ? "" : "this page is not logged in" + becomes;
}

Reply<std::string> Authentication::log_in(const PeerIdentity& peer, std::string_view token,
                                          std::string_view code, Time now,
                                          WallClock::time_point wall) {
    if (!token.empty() && !policy_.tokens)
        return refuse(Code::not_allowed, "this daemon has no tokens: run raynest open");
    auto principal = token.empty() ? by_code(peer, code, now, wall)
                                   : by_token(peer, token, now, wall, Audit::logins);
    if (!principal) return tl::unexpected(principal.error());
    return logins_.begin(std::move(*principal), wall);
}

tl::unexpected<protocol::Error> Authentication::refuse_secret(const PeerIdentity& peer, Time now,
                                                              const char* reason, const char* why) {
    refuse_login(peer, "", reason);
    const milliseconds wait = failures_.wait_of(peer.name, now);
    if (wait.count() != 0)
        return tl::unexpected(protocol::Error{Code::busy,
                                              "too many wrong tokens came from " + peer.name,
                                              static_cast<std::uint32_t>(wait.count())});
    failures_.failed(peer.name, now);
    return refuse(Code::not_allowed, why);
}

Reply<Principal> Authentication::by_code(const PeerIdentity& peer, std::string_view code, Time now,
                                         WallClock::time_point wall) {
    const auto principal = logins_.take_code(code, wall);
    if (!principal || !still_valid(*principal, wall))
        return refuse_secret(
            peer, now, "unknown, used or expired code",
            "the code of this address was used or has expired; run raynest open again");
    failures_.succeeded(peer.name);
    audit_login(peer, principal->id, "code");
    return *principal;
}

Reply<Principal> Authentication::by_token(const PeerIdentity& peer, std::string_view token,
                                          Time now, WallClock::time_point wall, Audit audited) {
    const TokenRow* row = tokens_->find_token(token, wall);
    if (row == nullptr)
        return refuse_secret(peer, now, "unknown, expired or revoked token",
                             "the token is unknown here, has expired or was revoked; ask for a new "
                             "one (raynestd token add NAME)");
    failures_.succeeded(peer.name);
    if (audited == Audit::logins) audit_login(peer, row->name, "token");
    return principal_of(*row, {Admittance::By::token});
}

std::optional<Principal> Authentication::holder_of(
    const std::string& subject, const std::shared_ptr<const ClientCertificate>& certificate,
    WallClock::time_point wall) const {
    if (!policy_.certificates || certificate == nullptr || !trust_ || !trust_(*certificate, wall))
        return std::nullopt;
    Admittance admittance{Admittance::By::certificate};
    admittance.certificate = certificate;
    const TokenRow* row = tokens_->find_name(subject);
    if (row == nullptr) return Principal{subject, {}, Role::user, "", 0, std::move(admittance)};
    if (!lets_in(*row, TokenRow::Kind::certificate, wall)) return std::nullopt;
    return principal_of(*row, std::move(admittance));
}

Reply<Principal> Authentication::by_certificate(const PeerIdentity& peer,
                                                WallClock::time_point wall, Audit audited) {
    auto principal = holder_of(peer.subject, peer.certificate, wall);
    if (!principal) {
        refuse_login(peer, peer.subject, "certificate");
        return refuse(Code::not_allowed, "the access of the certificate " + peer.subject +
                                             " has expired or was revoked");
    }
    certificate_ends_.insert(peer.certificate->expires);
    if (audited == Audit::logins) audit_login(peer, peer.subject, "certificate");
    return std::move(*principal);
}

std::optional<Role> role_without(const AccessPolicy& policy, PeerIdentity::Place place,
                                 std::string_view transport) {
    using Place = PeerIdentity::Place;
    if (place == Place::unknown_user) return std::nullopt;
    if (place == Place::own_user) return Role::admin;
    const bool asks = (is_encrypted(transport) && (policy.tokens || policy.certificates)) ||
                      (place == Place::remote && (policy.tokens || is_request(transport)));
    return asks ? std::nullopt : policy.anonymous;
}

Reply<Principal> Authentication::anonymous(const PeerIdentity& peer) const {
    if (const auto role = role_without(policy_, peer.place, peer.transport))
        return Principal{
            peer.name, {}, *role,
            "",        0,  {Admittance::By::transport, peer.place, is_encrypted(peer.transport)}};
    if (peer.place == PeerIdentity::Place::unknown_user) {
        refuse_login(peer, "", "unknown user");
        return refuse(Code::not_allowed,
                      peer.name +
                          " stands for several users, because the daemon runs in a user "
                          "namespace; come with a token, or run the daemon without "
                          "PrivateUsers=");
    }
    if (!peer.subject_fault.empty()) {
        const std::string fault = "the subject of this client's certificate " + peer.subject_fault;
        refuse_login(peer, "", fault);
        return refuse(Code::not_allowed, fault +
                                             ", and names nobody; make one with a short subject "
                                             "such as CN=robot");
    }
    refuse_login(peer, "", "no token");
    if (is_request(peer.transport) && peer.place == PeerIdentity::Place::remote &&
        !policy_.tokens && !policy_.certificates)
        return refuse(
            Code::not_allowed,
            "the page asks for a token unless it is opened on the daemon's own machine, as "
            "localhost and without a proxy: start raynestd with --tokens FILE, or run there: "
            "raynest open");
    return refuse(Code::not_allowed,
                  policy_.certificates && !policy_.tokens
                      ? "this daemon asks for a client certificate: pass --cert FILE and --key FILE"
                      : std::string("this daemon asks for a token: ") + token_remedy);
}

void Authentication::refuse_login(const PeerIdentity& peer, const std::string& principal,
                                  const std::string& reason) const {
    if (refused_ != nullptr) ++*refused_;
    log_limited(LogLevel::info, "login_refused", peer.name,
                {{"peer", peer.whereabouts()},
                 {"transport", peer.transport},
                 {"principal", principal},
                 {"reason", reason}});
}

bool Authentication::still_valid(const Principal& principal, WallClock::time_point wall) const {
    if (principal.page_login != 0 && !logins_.goes_on(principal.page_login)) return false;
    const Admittance& admittance = principal.admittance;
    switch (admittance.by) {
        case Admittance::By::transport:
            // Local requests have the role of other local peers, and remote ones are not admitted
            // so.
            return role_without(policy_, admittance.place,
                                admittance.is_encrypted ? "tls" : "tcp") == principal.role;
        case Admittance::By::certificate: {
            const auto again = holder_of(principal.id, admittance.certificate, wall);
            return again && again->credential == principal.credential;
        }
        case Admittance::By::token: {
            const TokenRow* row = tokens_->find_name(principal.id);
            return policy_.tokens && row != nullptr && lets_in(*row, TokenRow::Kind::token, wall) &&
                   credential_of(*row) == principal.credential;
        }
    }
    return false;
}

bool Authentication::certificates_ended(WallClock::time_point now) {
    const auto first_good = certificate_ends_.upper_bound(now);
    const bool ended = first_good != certificate_ends_.begin();
    certificate_ends_.erase(certificate_ends_.begin(), first_good);
    return ended;
}

Reply<Principal> authenticate(const PeerIdentity& peer, const wire::Hello& /*hello*/,
                              const protocol::Limits& /*limits*/) {
    Authentication without_tokens;
    return without_tokens.identify(peer, "", {}, {});
}

}  // namespace raynest::server
