#include "server/options/listen_policy.h"

#include "server/ground/address.h"

#include <sys/stat.h>

#include <set>
#include <utility>

namespace raynest::server {
namespace {

using Place = PeerIdentity::Place;

bool is_encrypted(const Address& address) {
    const std::string scheme = scheme_of(address);
    const Scheme* known = find_scheme(scheme);
    return known != nullptr ? known->encrypted : scheme == "https";
}

/// Returns where peers of an address may come from.
std::vector<Place> places_of(const Address& address, const SocketAccess& socket) {
    const auto* local = std::get_if<UnixAddress>(&address);
    if (local == nullptr)
        return is_beyond_loopback(address) ? std::vector{Place::loopback, Place::remote}
                                           : std::vector{Place::loopback};
    // Connecting needs the right to write. Another program has set the mode of an inherited socket.
    constexpr unsigned others_write = 0022;
    struct stat file {};
    unsigned mode = socket.mode;
    if (local->descriptor >= 0)
        mode = ::stat(local->path.c_str(), &file) == 0 ? file.st_mode : others_write;
    const bool is_shared = (mode & others_write) != 0;
    return is_shared ? std::vector{Place::own_user, Place::other_user}
                     : std::vector{Place::own_user};
}

/// Returns what an address lacks; empty if nothing.
std::string fault_of(const ListenAddress& at, const SecurityOptions& security) {
    const bool encrypted = is_encrypted(at.address);
    if (encrypted && security.tls.certificate.empty())
        return " needs --tls-cert and --tls-key; raynestd tls init DIR makes them";
    if (!is_beyond_loopback(at.address)) return "";
    const bool is_http = at.option == "http";
    if (!encrypted && !security.insecure)
        return std::string(" can be reached from other machines, and plain ") +
               (is_http ? "HTTP" : "TCP") + " shows the network all that is sent; " +
               (is_http ? "serve https://HOST:PORT, or keep 127.0.0.1 and forward the port: ssh -L "
                          "31061:127.0.0.1:31061 HOST"
                        : "listen on tls://") +
               ", or pass --insecure";
    if (encrypted && security.tokens.empty() && security.tls.client_ca.empty())
        return " can be reached from other machines; give --tokens FILE (raynestd token add NAME) "
               "or "
               "--client-ca FILE, so that not everybody may use it";
    return "";
}

std::optional<OptionFault> tls_fault(const TlsFiles& tls) {
    if (!tls.certificate.empty() && tls.key.empty())
        return OptionFault{"tls-cert", "", "needs --tls-key: the two belong together"};
    if (tls.certificate.empty() && !tls.key.empty())
        return OptionFault{"tls-key", "", "needs --tls-cert: the two belong together"};
    if (!tls.client_ca.empty() && tls.certificate.empty())
        return OptionFault{"client-ca", "", "needs --tls-cert and --tls-key"};
    return std::nullopt;
}

/// Returns how `then` lets in more than `now`; empty if it does not.
std::string gain(const Openness& now, const Openness& then) {
    if (!then.fault.empty()) return then.fault;
    for (const auto& [place, role] : then.strangers)
        if (role > now.strangers.at(place))
            return " would let peers without a token or certificate in as " +
                   std::string(role_name(*role));
    if (now.tokens && !then.tokens && then.certificates)
        return " would let certificates in that the token file shuts out";
    return "";
}

}  // namespace

tl::expected<std::vector<ListenAddress>, OptionFault> listen_addresses(const Options& options) {
    std::vector<ListenAddress> addresses;
    std::set<std::string> seen;
    for (const std::string& uri : options.listen) {
        auto address = parse_address(uri);
        if (!address) return tl::unexpected(OptionFault{"listen", uri, address.error().message});
        // Port 0 is a different port each time.
        if (const std::string place = to_uri(*address);
            !place.ends_with(":0") && !seen.insert(place).second)
            return tl::unexpected(OptionFault{"listen", uri, "'" + uri + "' is given twice"});
        addresses.push_back({"listen", uri, std::move(*address)});
    }
    const std::string& http = options.http.address;
    if (http == "off") return addresses;
    auto address = parse_http_address(http);
    if (!address) return tl::unexpected(OptionFault{"http", http, address.error().message});
    addresses.push_back({"http", http, std::move(*address)});
    return addresses;
}

std::optional<OptionFault> listen_fault(const Options& options) {
    if (auto fault = tls_fault(options.security.tls)) return fault;
    const auto addresses = listen_addresses(options);
    if (!addresses) return addresses.error();
    for (const ListenAddress& at : *addresses)
        if (const std::string fault = openness(at, options.security, options.socket).fault;
            !fault.empty())
            return OptionFault{at.option, at.value, at.value + fault};
    return std::nullopt;
}

Openness openness(const ListenAddress& at, const SecurityOptions& security,
                  const SocketAccess& socket) {
    const AccessPolicy policy = policy_of(security);
    Openness open;
    for (const Place place : places_of(at.address, socket))
        open.strangers[place] = role_without(policy, place, scheme_of(at.address));
    open.tokens = policy.tokens;
    open.certificates = is_encrypted(at.address) && policy.certificates;
    open.fault = fault_of(at, security);
    return open;
}

std::string to_text(const Openness& open) {
    static const std::map<Place, std::string> names = {
        {Place::own_user, "the daemon's user and root"},
        {Place::other_user, "other users of this machine"},
        {Place::loopback, "this machine"},
        {Place::remote, "other machines"},
    };
    std::string text;
    const auto add = [&](const std::string& part) { text += (text.empty() ? "" : "; ") + part; };
    if (open.tokens) add("tokens");
    if (open.certificates) add("certificates");
    for (const auto& [place, role] : open.strangers)
        if (role) add(names.at(place) + " as " + std::string(role_name(*role)));
    return text.empty() ? "nobody" : text;
}

std::string weakened(const std::vector<ListenAddress>& open, const SecurityOptions& now,
                     const SecurityOptions& then, const SocketAccess& socket) {
    if (const auto fault = tls_fault(then.tls)) return fault->option + ' ' + fault->why;
    for (const ListenAddress& at : open)
        if (const std::string why = gain(openness(at, now, socket), openness(at, then, socket));
            !why.empty())
            return to_uri(at.address) + why;
    return "";
}

}  // namespace raynest::server
