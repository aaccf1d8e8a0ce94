// The daemon: what administrators and reloads change while it runs.
#include "server/daemon/notify.h"
#include "server/daemon/wiring.h"
#include "server/options/limits_in_force.h"
#include "server/options/reload.h"

namespace raynest::server {

void Daemon::end_revoked(bool is_site_smaller) {
    const auto valid = [this, now = WallClock::now()](const Principal& principal) {
        return credentials_.authentication().still_valid(principal, now);
    };
    // A page comes back at once under a host, or by a proxy, that is still one of ours. By value:
    // it is asked in later turns, too.
    const auto may_stay = [valid, is_site_smaller](const PeerIdentity& peer,
                                                   const Principal& principal) {
        return !(is_site_smaller && peer.sender != nullptr) && valid(principal);
    };
    const std::string why = " is admitted no more: a token, certificate, login or option changed";
    connections_.close_unless(may_stay, {Code::not_allowed, "this connection" + why, 0});
    detached_.end_unless(valid, {Code::not_allowed, "the owner of this job" + why, 0});
}

Reply<std::string> Daemon::reload() {
    notify("RELOADING=1");
    const Reload done = reload_options(
        options_, read_again_ ? read_again_() : Result<Options>(options_), credentials_, open_);
    apply_options();
    end_revoked(done.is_site_smaller);
    notify("READY=1");
    return told(done);
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
