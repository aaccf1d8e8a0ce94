#include "server/net/transports.h"
#include "server/options.h"

#include <set>

namespace raynest::server {
namespace {

/// How an address is told in messages, and the advice in place of a plain one.
struct Place {
    const Address& address;
    std::string option;
    std::string value;
    bool is_encrypted;
    std::string plain;   ///< name of the plain protocol
    std::string advice;  ///< how to serve other machines
};

/// Returns what one address lacks; empty if nothing.
std::string fault_of(const Place& place, const SecurityOptions& security) {
    const bool has_certificate = !security.tls.certificate.empty();
    if (place.is_encrypted && !has_certificate)
        return " needs --tls-cert and --tls-key; raynestd tls init DIR makes them";
    if (!is_beyond_loopback(place.address)) return "";
    if (!place.is_encrypted && !security.insecure)
        return " can be reached from other machines, and plain " + place.plain +
               " shows the network all that is sent; " + place.advice + ", or pass --insecure";
    if (place.is_encrypted && security.tokens.empty() && security.tls.client_ca.empty())
        return " can be reached from other machines; give --tokens FILE (raynestd token add NAME) or "
               "--client-ca FILE, so that not everybody may use it";
    return "";
}

std::optional<OptionFault> find_fault(const Place& place, const SecurityOptions& security) {
    const std::string fault = fault_of(place, security);
    if (fault.empty()) return std::nullopt;
    return OptionFault{place.option, place.value, place.value + fault};
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

}  // namespace

std::optional<OptionFault> listen_fault(const Options& options) {
    const SecurityOptions& security = options.security;
    if (auto fault = tls_fault(security.tls)) return fault;
    std::set<std::string> seen;
    for (const std::string& uri : options.listen) {
        const auto address = parse_address(uri);
        if (!address) return OptionFault{"listen", uri, address.error().message};
        // Port 0 is a different port each time.
        if (const std::string place = to_uri(*address);
            !place.ends_with(":0") && !seen.insert(place).second)
            return OptionFault{"listen", uri, "'" + uri + "' is given twice"};
        const bool is_encrypted = find_scheme(scheme_of(*address))->encrypted;
        if (auto fault = find_fault(
                {*address, "listen", uri, is_encrypted, "TCP", "listen on tls://"}, security))
            return fault;
    }
    const std::string& http = options.http.address;
    if (http == "off") return std::nullopt;
    const auto address = parse_http_address(http);
    if (!address) return OptionFault{"http", http, address.error().message};
    return find_fault({*address, "http", http, scheme_of(*address) == "https", "HTTP",
                       "serve https://HOST:PORT, or keep 127.0.0.1 and forward the port: ssh -L "
                       "31061:127.0.0.1:31061 HOST"},
                      security);
}

}  // namespace raynest::server
