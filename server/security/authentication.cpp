#include "server/security/authentication.h"

#include "server/log.h"

#include <algorithm>
#include <utility>

namespace raynest::server {
namespace {

using std::chrono::milliseconds;

/// Wrong tokens from one address before it must wait.
constexpr unsigned free_failures = 5;
constexpr milliseconds wait_min{250};
constexpr milliseconds wait_max{30'000};
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

Principal principal_of(const TokenRow& row) {
    return {row.name, row.quota, row.role, credential_of(row)};
}

void audit(const char* event, const PeerIdentity& peer, const std::string& principal,
           const char* reason) {
    log(LogLevel::info, event,
        {{"peer", peer.name},
         {"transport", peer.transport},
         {"principal", principal},
         {"reason", reason}});
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
    ++entry.failures;
    entry.last = now;
}

Reply<Principal> Authentication::identify(const PeerIdentity& peer, std::string_view token,
                                          Time now, WallClock::time_point wall) {
    if (!token.empty() && policy_.tokens) return by_token(peer, token, now, wall, Audit::logins);
    if (peer.sender != nullptr) {
        if (!still_valid(*peer.sender, wall))
            return refuse(Code::not_allowed, "the login of this page has ended; open it again");
        audit("login", peer, peer.sender->id, "page");
        return *peer.sender;
    }
    if (!peer.subject.empty()) return by_certificate(peer, wall, Audit::logins);
    return anonymous(peer);
}

Reply<Principal> Authentication::identify_request(const PeerIdentity& peer, std::string_view bearer,
                                                  std::string_view cookie, Time now,
                                                  WallClock::time_point wall) {
    if (!bearer.empty() && policy_.tokens) return by_token(peer, bearer, now, wall, Audit::refusals);
    if (const Principal* known = logins_.find(cookie, wall);
        known != nullptr && still_valid(*known, wall))
        return *known;
    if (!peer.subject.empty()) return by_certificate(peer, wall, Audit::refusals);
    return anonymous(peer);
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
                                                              const char* reason,
                                                              const char* why) {
    const milliseconds wait = failures_.wait_of(peer.name, now);
    if (wait.count() != 0)
        return tl::unexpected(protocol::Error{Code::busy,
                                              "too many wrong tokens came from " + peer.name,
                                              static_cast<std::uint32_t>(wait.count())});
    failures_.failed(peer.name, now);
    audit("login_refused", peer, "", reason);
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
    audit("login", peer, principal->id, "code");
    return *principal;
}

Reply<Principal> Authentication::by_token(const PeerIdentity& peer, std::string_view token, Time now,
                                          WallClock::time_point wall, Audit audited) {
    const TokenRow* row = tokens_.find_token(token, wall);
    if (row == nullptr)
        return refuse_secret(peer, now, "unknown, expired or revoked token",
                             "the token is unknown here, has expired or was revoked; ask for a new "
                             "one (raynestd token add NAME)");
    failures_.succeeded(peer.name);
    if (audited == Audit::logins) audit("login", peer, row->name, "token");
    return principal_of(*row);
}

Reply<Principal> Authentication::by_certificate(const PeerIdentity& peer,
                                                WallClock::time_point wall, Audit audited) const {
    const TokenRow* row = tokens_.find_name(peer.subject);
    const bool has_ended = row != nullptr && (row->kind != TokenRow::Kind::certificate ||
                                              (row->expires && wall >= *row->expires));
    if (has_ended || audited == Audit::logins)
        audit(has_ended ? "login_refused" : "login", peer, peer.subject, "certificate");
    if (has_ended)
        return refuse(Code::not_allowed, "the access of the certificate " + peer.subject +
                                             " has expired or was revoked");
    if (row != nullptr) return principal_of(*row);
    return Principal{peer.subject, {}, Role::user, ""};
}

Reply<Principal> Authentication::anonymous(const PeerIdentity& peer) const {
    using Place = PeerIdentity::Place;
    if (peer.place == Place::unknown_user) {
        audit("login_refused", peer, "", "unknown user");
        return refuse(Code::not_allowed,
                      peer.name + " stands for several users, because the daemon runs in a user "
                                  "namespace; come with a token, or run the daemon without "
                                  "PrivateUsers=");
    }
    if (peer.place == Place::own_user) return Principal{peer.name, {}, Role::admin, ""};
    const bool is_encrypted = peer.transport == "tls" || peer.transport == "https";
    const bool asks = (is_encrypted && (policy_.tokens || policy_.certificates)) ||
                      (peer.place == Place::remote && policy_.tokens);
    if (asks || !policy_.anonymous) {
        if (peer.subject_fault.empty()) {
            audit("login_refused", peer, "", "no token");
            const bool only_certificates = policy_.certificates && !policy_.tokens;
            return refuse(
                Code::not_allowed,
                only_certificates
                    ? "this daemon asks for a client certificate: pass --cert FILE and --key FILE"
                    : std::string("this daemon asks for a token: ") + token_remedy);
        }
        const std::string fault = "the subject of this client's certificate " + peer.subject_fault;
        audit("login_refused", peer, "", fault.c_str());
        return refuse(Code::not_allowed, fault + ", and names nobody; make one with a short subject "
                                                 "such as CN=robot");
    }
    return Principal{peer.name, {}, *policy_.anonymous, ""};
}

bool Authentication::still_valid(const Principal& principal, WallClock::time_point wall) const {
    if (principal.page_login != 0 && !logins_.goes_on(principal.page_login)) return false;
    if (principal.credential.empty()) return true;
    const TokenRow* row = tokens_.find_name(principal.id);
    return row != nullptr && credential_of(*row) == principal.credential &&
           (!row->expires || wall < *row->expires);
}

}  // namespace raynest::server
