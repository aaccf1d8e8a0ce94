// The daemon: what administrators and reloads change while it runs.
#include "server/daemon/notify.h"
#include "server/daemon/wiring.h"
#include "server/ground/limited_log.h"
#include "server/ground/log.h"
#include "server/options/limits_in_force.h"
#include "server/options/reload.h"
#include "server/scheduling/dispatched_task.h"

#include <exception>
#include <memory>
#include <string>
#include <utility>

namespace raynest::server {
namespace {

/// Tells systemd that a reload is under way, while it exists.
struct Reloading {
    Reloading() { notify("RELOADING=1"); }
    Reloading(const Reloading&) = delete;
    ~Reloading() { notify("READY=1"); }
};

}  // namespace

void Daemon::end_revoked(bool is_site_smaller) {
    const auto valid = [this](const Principal& principal) {
        return credentials_.authentication().still_valid(principal, WallClock::now());
    };
    // A page comes back at once under a host, or by a proxy, that is still one of ours. A Hello that
    // is yet to come meets the rule for principals by itself. By value: it is asked in later turns, too.
    const auto may_stay = [valid, is_site_smaller](const PeerIdentity& peer,
                                                   const Principal* principal) {
        return !(is_site_smaller && peer.sender != nullptr) &&
               (principal == nullptr || valid(*principal));
    };
    const std::string why = " is admitted no more: a token, certificate, login or option changed";
    connections_.close_unless(may_stay, {Code::not_allowed, "this connection" + why, 0},
                              is_site_smaller ? "revoked, site smaller" : "revoked");
    detached_.end_unless(valid, {Code::not_allowed, "the owner of this job" + why, 0});
}

void Daemon::elsewhere(std::function<std::function<void()>()> work) {
    compute_.submit("", Priority::high, [this, work = std::move(work)] {
        std::function<void()> then;
        try {
            then = work();
        } catch (const std::exception& error) {
            log_limited(LogLevel::error, "handler_failed", "", {{"reason", error.what()}});
            return;
        }
        post_surely(context_.post, then);
    });
}

void Daemon::look_at_credentials() {
    if (credentials_.any_expired(WallClock::now())) end_revoked();
    if (!tokens_reading_.expired() || !credentials_.tokens_changed()) return;
    const auto reading = std::make_shared<int>();
    tokens_reading_ = reading;
    elsewhere([this, reading, options = credentials_.options()]() -> std::function<void()> {
        const auto files = std::make_shared<Credentials::Files>(Credentials::read_tokens(options));
        return [this, reading, files] {
            if (!credentials_.take(std::move(*files))) return;
            log(LogLevel::info, "tokens_read",
                {{"rows", std::to_string(credentials_.authentication().tokens().rows().size())}});
            end_revoked();
        };
    });
}

std::function<Administration::Take()> Daemon::reload() {
    const auto options = [read = read_again_, now = options_] { return read ? read() : now; };
    return [this, options, now = options_.security, number = ++reloads_begun_]() -> Take {
        const auto told_of = std::make_shared<Reloading>();
        const auto read = std::make_shared<ReadAgain>(read_again(options, now));
        return [this, told_of, read, number]() -> Reply<std::string> {
            if (number < reload_taken_) return std::string("a later reload was faster");
            reload_taken_ = number;
            const Reload done = reload_options(options_, std::move(*read), credentials_, open_);
            apply_options();
            // Later: who asked for the reload may be ended by it.
            context_.post(
                [this, is_site_smaller = done.is_site_smaller] { end_revoked(is_site_smaller); });
            return told(done);
        };
    };
}

void Daemon::apply_options() {
    set_log_level(options_.log_level);
    set_log_format(options_.log_format);
    site_.set_names(options_.http.hosts);
    http_.set_proxies(AddressSet(options_.http.proxies));
    take_limits(limits_, limits_in_force(options_));
    admission_.set_limits(limits_);
    scenes_.set_limits(limits_);
    credentials_.authentication().logins().set_limits(limits_);
    look_after_detached();
}

std::size_t Daemon::kick(std::uint64_t connection, const std::string& principal) {
    return connections_.kick(connection, principal,
                             {Code::not_allowed, "an administrator has ended this connection", 0});
}

bool Daemon::knows(const std::string& principal) {
    return peers_.size_of(principal) != 0 || admission_.active_of(principal) != 0 ||
           scenes_.charged_to(principal, true).scenes != 0 ||
           credentials_.authentication().tokens().find_name(principal) != nullptr;
}

void Daemon::set_quota(const std::string& principal, const Quota& quota) {
    admission_.quotas().set(principal, quota);
    scenes_.quotas().set(principal, quota);
}

}  // namespace raynest::server
