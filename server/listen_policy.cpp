#include "server/net/transports.h"
#include "server/options.h"

namespace raynest::server {
namespace {

/// How an address is told in messages, and the advice in place of a plain one.
struct Place {
    const Address& address;
    std::string shown;  ///< option and value
    bool is_encrypted;
    std::string plain;   ///< name of the plain protocol
    std::string advice;  ///< how to serve other machines
};

/// Returns what one address lacks.
std::string fault_of(const Place& place, const SecurityOptions& security) {
    const bool has_certificate = !security.tls.certificate.empty();
    if (place.is_encrypted && !has_certificate)
        return place.shown + " needs --tls-cert and --tls-key; raynestd tls init DIR makes them";
    if (!is_beyond_loopback(place.address)) return "";
    if (!place.is_encrypted && !security.insecure)
        return place.shown + " can be reached from other machines, and plain " + place.plain +
               " shows the network all that is sent; " + place.advice + ", or pass --insecure";
    if (place.is_encrypted && security.tokens.empty() && security.tls.client_ca.empty())
        return place.shown + " can be reached from other machines; give --tokens FILE (raynestd " +
               "token add NAME) or --client-ca FILE, so that not everybody may use it";
    return "";
}

}  // namespace

std::string listen_fault(const Options& options) {
    const SecurityOptions& security = options.security;
    if (security.tls.certificate.empty() != security.tls.key.empty())
        return "--tls-cert and --tls-key belong together; give both";
    if (!security.tls.client_ca.empty() && security.tls.certificate.empty())
        return "--client-ca needs --tls-cert and --tls-key";
    for (const std::string& uri : options.listen) {
        const auto address = parse_address(uri);
        if (!address) return address.error().message;
        const bool is_encrypted = find_scheme(scheme_of(*address))->encrypted;
        if (std::string fault = fault_of(
                {*address, "--listen " + uri, is_encrypted, "TCP", "listen on tls://"}, security);
            !fault.empty())
            return fault;
    }
    if (options.http.address == "off") return "";
    const auto address = parse_http_address(options.http.address);
    if (!address) return address.error().message;
    return fault_of({*address, "--http " + options.http.address, scheme_of(*address) == "https",
                     "HTTP",
                     "serve https://HOST:PORT, or keep 127.0.0.1 and forward the port: ssh -L "
                     "31061:127.0.0.1:31061 HOST"},
                    security);
}

}  // namespace raynest::server
