// Decides who may see the page, by the daemon's tokens and logins.
#pragma once

#include "server/http/site.h"
#include "server/security/authentication.h"

#include <chrono>
#include <functional>
#include <utility>

namespace raynest::server {

/// Io thread only.
class PageAccess final : public HttpAccess {
public:
    /// `end_revoked` ends the connections whose principal is no longer valid.
    PageAccess(Authentication& authentication, std::function<void()> end_revoked)
        : authentication_(authentication),
          end_revoked_(std::move(end_revoked)) {}

    Reply<Principal> identify(const PeerIdentity& peer, std::string_view bearer,
                              std::string_view cookie) override {
        return authentication_.identify_request(peer, bearer, cookie, now(), WallClock::now());
    }
    std::string question_before(const PeerIdentity& peer, std::string_view code,
                                std::string_view cookie) override {
        return authentication_.question_before(peer, code, cookie, WallClock::now());
    }
    Reply<std::string> log_in(const PeerIdentity& peer, std::string_view token,
                              std::string_view code) override {
        return authentication_.log_in(peer, token, code, now(), WallClock::now());
    }
    void log_out(std::string_view cookie) override {
        if (authentication_.logins().end(cookie)) end_revoked_();
    }
    /// Ends logins whose time is over, and the connections of those that have ended.
    void look_at_logins() {
        if (authentication_.logins().expire(WallClock::now())) end_revoked_();
    }

private:
    static Authentication::Time now() { return std::chrono::steady_clock::now(); }

    Authentication& authentication_;
    const std::function<void()> end_revoked_;
};

}  // namespace raynest::server
