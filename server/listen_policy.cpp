#include "server/net/transports.h"
#include "server/options.h"

namespace raynest::server {
namespace {

/// Returns what one address lacks.
std::string fault_of(const Address& address, const std::string& shown, bool is_encrypted,
                     const SecurityOptions& security) {
    const bool has_certificate = !security.tls.certificate.empty();
    if (is_encrypted && !has_certificate)
        return shown + " needs --tls-cert and --tls-key; raynestd tls init DIR makes them";
    if (!is_beyond_loopback(address)) return "";
    if (!is_encrypted && !security.insecure)
        return shown + " can be reached from other machines, and plain TCP shows the network all " +
               "that is sent; listen on tls://, or pass --insecure";
    if (is_encrypted && security.tokens.empty() && security.tls.client_ca.empty())
        return shown + " can be reached from other machines; give --tokens FILE (raynestd token " +
               "add NAME) or --client-ca FILE, so that not everybody may use it";
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
        if (std::string fault = fault_of(*address, "--listen " + uri, is_encrypted, security);
            !fault.empty())
            return fault;
    }
    if (options.http.address == "off") return "";
    const auto address = parse_http_address(options.http.address);
    if (!address) return address.error().message;
    if (is_beyond_loopback(*address))
        return "--http " + options.http.address +
               " can be reached from other machines, and the page has neither encryption nor a "
               "password; keep 127.0.0.1 and forward the port: ssh -L 31061:127.0.0.1:31061 HOST";
    return "";
}

}  // namespace raynest::server
