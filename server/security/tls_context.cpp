#include "server/security/tls_context.h"

#include "server/security/pem_file.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <openssl/err.h>
#include <openssl/x509.h>
#include <openssl/x509v3.h>

#include <array>
#include <ctime>

namespace raynest::server {
namespace {

/// Encrypted bytes that one read of a socket takes. The buffer is given back when it is empty.
constexpr std::size_t read_ahead_bytes = 64 << 10;

std::chrono::system_clock::time_point to_time(const ASN1_TIME* time) {
    std::tm parts{};
    if (time == nullptr || ASN1_TIME_to_tm(time, &parts) != 1) return {};
    return std::chrono::system_clock::from_time_t(timegm(&parts));
}

/// Returns the text of an IP address in a certificate; empty if it is none.
std::string address_text(const ASN1_OCTET_STRING* address) {
    std::array<char, INET6_ADDRSTRLEN> text{};
    const int size = ASN1_STRING_length(address);
    if (size != sizeof(in_addr) && size != sizeof(in6_addr)) return "";
    const int family = size == sizeof(in_addr) ? AF_INET : AF_INET6;
    return inet_ntop(family, ASN1_STRING_get0_data(address), text.data(), text.size());
}

std::vector<std::string> names_of(const X509* certificate) {
    const std::unique_ptr<GENERAL_NAMES, void (*)(GENERAL_NAMES*)> all(
        static_cast<GENERAL_NAMES*>(
            X509_get_ext_d2i(certificate, NID_subject_alt_name, nullptr, nullptr)),
        GENERAL_NAMES_free);
    std::vector<std::string> names;
    for (int i = 0; all != nullptr && i < sk_GENERAL_NAME_num(all.get()); ++i) {
        const GENERAL_NAME* name = sk_GENERAL_NAME_value(all.get(), i);
        if (name->type == GEN_IPADD) names.push_back(address_text(name->d.iPAddress));
        if (name->type == GEN_DNS)
            names.emplace_back(
                reinterpret_cast<const char*>(ASN1_STRING_get0_data(name->d.dNSName)),
                static_cast<std::size_t>(ASN1_STRING_length(name->d.dNSName)));
    }
    return names;
}

/// Sets what every listener of this daemon allows: TLS 1.2 and 1.3, with no renegotiation, no
/// compression and no session tickets. Clients keep no sessions, so tickets would only cost bytes.
void restrict_protocol(SSL_CTX* context) {
    SSL_CTX_set_min_proto_version(context, TLS1_2_VERSION);
    SSL_CTX_set_options(context, SSL_OP_NO_RENEGOTIATION | SSL_OP_NO_COMPRESSION |
                                     SSL_OP_NO_TICKET | SSL_OP_CIPHER_SERVER_PREFERENCE);
    SSL_CTX_set_num_tickets(context, 0);
    SSL_CTX_set_session_cache_mode(context, SSL_SESS_CACHE_OFF);
    // Forward secrecy and authenticated encryption only, also for TLS 1.2.
    SSL_CTX_set_cipher_list(context, "ECDHE+AESGCM:ECDHE+CHACHA20");
    // Elliptic curves only: the handshake runs on the io thread and clients choose the group. A key
    // exchange by ffdhe8192 takes 6.4 ms, by the slowest of these 0.3 ms.
    SSL_CTX_set1_groups_list(context, "X25519:P-256:X448:P-521:P-384");
    // AES-128 first: it takes 0.8 times the CPU of AES-256.
    SSL_CTX_set_ciphersuites(context,
                             "TLS_AES_128_GCM_SHA256:TLS_AES_256_GCM_SHA384:"
                             "TLS_CHACHA20_POLY1305_SHA256");
    // One read of the socket takes several records: else each takes two.
    SSL_CTX_set_read_ahead(context, 1);
    SSL_CTX_set_default_read_buffer_len(context, read_ahead_bytes);
    // A write may take a part of its bytes, and go on from another buffer; idle connections give
    // their buffers back.
    SSL_CTX_set_mode(context, SSL_MODE_ENABLE_PARTIAL_WRITE | SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER |
                                  SSL_MODE_RELEASE_BUFFERS);
}

/// Uses the first certificate as the daemon's own, and the others as its chain.
Result<void> use_chain(SSL_CTX* context, const std::filesystem::path& file,
                       const std::vector<Certificate>& certificates) {
    ERR_clear_error();
    bool good = SSL_CTX_use_certificate(context, certificates.front().get()) == 1;
    for (std::size_t i = 1; good && i < certificates.size(); ++i)
        good = SSL_CTX_add1_chain_cert(context, certificates[i].get()) == 1;
    if (good) return {};
    return unusable(file, "the certificate cannot be used: " + tls_error_text());
}

}  // namespace

Result<std::shared_ptr<const TlsContext>> TlsContext::load(const TlsFiles& files) {
    const std::shared_ptr<TlsContext> made(new TlsContext);
    made->context_.reset(SSL_CTX_new(TLS_server_method()));
    SSL_CTX* context = made->context_.get();
    if (context == nullptr) return fail(ErrorCode::out_of_memory, tls_error_text());
    restrict_protocol(context);

    const auto certificates = read_certificates(files.certificate);
    if (!certificates) return tl::unexpected(certificates.error());
    if (auto used = use_chain(context, files.certificate, *certificates); !used)
        return tl::unexpected(used.error());
    const auto key = read_key(files.key, Reader::daemon);
    if (!key) return tl::unexpected(key.error());
    if (SSL_CTX_use_PrivateKey(context, key->get()) != 1 ||
        SSL_CTX_check_private_key(context) != 1) {
        ERR_clear_error();
        return unusable(files.key, "this key does not fit the certificate " +
                                       files.certificate.string() +
                                       "; give the two that were made together");
    }
    // Clients refuse a certificate that names its uses, but not this one; its owner would look
    // there.
    if ((X509_get_extended_key_usage(SSL_CTX_get0_certificate(context)) & XKU_SSL_SERVER) == 0)
        return unusable(
            files.certificate,
            "this certificate is not for servers: its extended key usage lacks serverAuth; "
            "give the server's, which tls init calls cert.pem");
    made->names_ = names_of(SSL_CTX_get0_certificate(context));
    made->expires_ = to_time(X509_get0_notAfter(SSL_CTX_get0_certificate(context)));
    if (made->expires_ < std::chrono::system_clock::now())
        return unusable(files.certificate, "the certificate has expired; raynestd tls renew DIR");

    if (!files.client_ca.empty()) {
        const auto known = read_certificates(files.client_ca);
        if (!known) return tl::unexpected(known.error());
        X509_STORE* store = SSL_CTX_get_cert_store(context);
        for (const Certificate& ca : *known)
            if (X509_STORE_add_cert(store, ca.get()) != 1 ||
                SSL_CTX_add_client_CA(context, ca.get()) != 1)
                return unusable(files.client_ca, tls_error_text());
        // A peer may leave its certificate out: Hello can bring a token instead.
        SSL_CTX_set_verify(context, SSL_VERIFY_PEER, nullptr);
        // OpenSSL takes 100 KiB of certificates apart before it verifies one, on the io thread.
        constexpr long chain_bytes_max = 8 << 10;
        SSL_CTX_set_max_cert_list(context, chain_bytes_max);
    }
    return std::shared_ptr<const TlsContext>(made);
}

std::shared_ptr<const ClientCertificate> TlsContext::certificate_of(SSL* connection) const {
    const auto share = [](X509* certificate) {
        return std::shared_ptr<X509>(certificate, X509_free);
    };
    auto own = share(SSL_get1_peer_certificate(connection));
    if (own == nullptr || SSL_get_verify_result(connection) != X509_V_OK) return nullptr;
    auto made = std::make_shared<ClientCertificate>();
    made->expires = to_time(X509_get0_notAfter(own.get()));
    made->verified_by = shared_from_this();
    made->chain.push_back(std::move(own));
    const STACK_OF(X509)* sent = SSL_get_peer_cert_chain(connection);
    for (int i = 0; i < sk_X509_num(sent); ++i) {
        X509* signer = sk_X509_value(sent, i);
        X509_up_ref(signer);
        made->chain.push_back(share(signer));
    }
    return made;
}

bool TlsContext::trusts(const ClientCertificate& certificate,
                        std::chrono::system_clock::time_point now) const {
    if (now >= certificate.expires) return false;
    if (certificate.verified_by.get() == this) return true;
    using Context = std::unique_ptr<X509_STORE_CTX, protocol::Release<X509_STORE_CTX_free>>;
    const Context check(X509_STORE_CTX_new());
    // The certificates stay the property of `chain`.
    struct FreeStack {
        void operator()(STACK_OF(X509) * stack) const { sk_X509_free(stack); }
    };
    const std::unique_ptr<STACK_OF(X509), FreeStack> signers(sk_X509_new_null());
    if (certificate.chain.empty() || check == nullptr || signers == nullptr) return false;
    for (const auto& signer : certificate.chain)
        if (sk_X509_push(signers.get(), signer.get()) <= 0) return false;
    const bool trusted = X509_STORE_CTX_init(check.get(), SSL_CTX_get_cert_store(get()),
                                             certificate.chain.front().get(), signers.get()) == 1 &&
                         X509_STORE_CTX_set_default(check.get(), "ssl_client") == 1 &&
                         X509_verify_cert(check.get()) == 1;
    ERR_clear_error();
    if (trusted) certificate.verified_by = shared_from_this();
    return trusted;
}

}  // namespace raynest::server
