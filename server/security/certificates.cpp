#include "server/security/certificates.h"

#include "server/security/pem_file.h"
#include "server/security/secret_file.h"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <netdb.h>
#include <netinet/in.h>
#include <openssl/bio.h>
#include <openssl/ec.h>
#include <openssl/pem.h>
#include <openssl/rand.h>
#include <openssl/x509v3.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <memory>
#include <set>
#include <utility>

namespace raynest::server {
namespace {

namespace fs = std::filesystem;

using Memory = std::unique_ptr<BIO, protocol::Release<BIO_free>>;

constexpr long day_seconds = 24L * 3600;
constexpr long ca_days = 3650;
/// Browsers refuse certificates of more than 398 days.
constexpr long days = 397;
/// Clocks of clients may be behind.
constexpr long early_seconds = 3600;

tl::unexpected<Error> failed(const std::string& what) {
    return fail(ErrorCode::internal, what + ": " + tls_error_text());
}

bool is_address(const std::string& name) {
    in6_addr storage{};
    return inet_pton(AF_INET, name.c_str(), &storage) == 1 ||
           inet_pton(AF_INET6, name.c_str(), &storage) == 1;
}

std::string alternative_names(const std::vector<std::string>& names) {
    std::string text;
    for (const std::string& name : names)
        text.append(text.empty() ? "" : ",").append(is_address(name) ? "IP:" : "DNS:").append(name);
    return text;
}

/// The CA that signs; itself for its own certificate.
struct Issuer {
    X509* certificate;
    EVP_PKEY* key;
};

bool add_extension(X509* certificate, const Issuer& issuer, int kind, const std::string& value) {
    X509V3_CTX context;
    X509V3_set_ctx_nodb(&context);
    X509V3_set_ctx(&context, issuer.certificate, certificate, nullptr, nullptr, 0);
    const std::unique_ptr<X509_EXTENSION, protocol::Release<X509_EXTENSION_free>> made(
        X509V3_EXT_conf_nid(nullptr, &context, kind, value.c_str()));
    return made != nullptr && X509_add_ext(certificate, made.get(), -1) == 1;
}

bool set_serial(X509* certificate) {
    std::array<unsigned char, 16> random{};
    if (RAND_bytes(random.data(), static_cast<int>(random.size())) != 1) return false;
    random[0] &= 0x7F;
    const std::unique_ptr<BIGNUM, protocol::Release<BN_free>> number(
        BN_bin2bn(random.data(), static_cast<int>(random.size()), nullptr));
    return BN_to_ASN1_INTEGER(number.get(), X509_get_serialNumber(certificate)) != nullptr;
}

struct Extension {
    int kind;
    std::string value;
};

/// Makes a certificate that is valid for so many seconds. Without `issuer` it signs itself.
Result<Certificate> sign(EVP_PKEY* key, const std::string& common_name, long valid_seconds,
                         const std::vector<Extension>& extensions, const Issuer* issuer) {
    Certificate made(X509_new());
    X509* certificate = made.get();
    const Issuer self{certificate, key};
    const Issuer& by = issuer == nullptr ? self : *issuer;
    X509_NAME* name = X509_get_subject_name(certificate);
    bool good = X509_set_version(certificate, X509_VERSION_3) == 1 && set_serial(certificate) &&
                X509_gmtime_adj(X509_getm_notBefore(certificate), -early_seconds) != nullptr &&
                X509_gmtime_adj(X509_getm_notAfter(certificate), valid_seconds) != nullptr &&
                X509_set_pubkey(certificate, key) == 1 &&
                X509_NAME_add_entry_by_txt(
                    name, "CN", MBSTRING_UTF8,
                    reinterpret_cast<const unsigned char*>(common_name.c_str()), -1, -1, 0) == 1 &&
                X509_set_issuer_name(certificate, X509_get_subject_name(by.certificate)) == 1;
    for (const auto& [kind, value] : extensions)
        good = good && add_extension(certificate, by, kind, value);
    good = good && add_extension(certificate, by, NID_subject_key_identifier, "hash") &&
           add_extension(certificate, by, NID_authority_key_identifier, "keyid:always") &&
           X509_sign(certificate, by.key, EVP_sha256()) > 0;
    if (!good) return failed("cannot make the certificate of " + common_name);
    return made;
}

std::string text_of(const Memory& memory) {
    char* bytes = nullptr;
    const long size = BIO_get_mem_data(memory.get(), &bytes);
    return {bytes, static_cast<std::size_t>(std::max(size, 0L))};
}

std::string to_pem(X509* certificate) {
    const Memory memory(BIO_new(BIO_s_mem()));
    PEM_write_bio_X509(memory.get(), certificate);
    return text_of(memory);
}

std::string to_pem(EVP_PKEY* key) {
    const Memory memory(BIO_new(BIO_s_mem()));
    PEM_write_bio_PrivateKey(memory.get(), key, nullptr, nullptr, 0, nullptr, nullptr);
    return text_of(memory);
}

const std::string ca_uses = "critical,keyCertSign,cRLSign";
const std::string end_uses = "critical,digitalSignature";

std::vector<Extension> server_extensions(const std::string& names) {
    return {{NID_basic_constraints, "critical,CA:FALSE"},
            {NID_key_usage, end_uses},
            {NID_ext_key_usage, "serverAuth"},
            {NID_subject_alt_name, names}};
}

std::vector<Extension> client_extensions() {
    return {{NID_basic_constraints, "critical,CA:FALSE"},
            {NID_key_usage, end_uses},
            {NID_ext_key_usage, "clientAuth"}};
}

/// Returns the subjectAltName of a certificate as alternative_names() writes it.
std::string alternative_names(X509* certificate) {
    const std::unique_ptr<GENERAL_NAMES, protocol::Release<GENERAL_NAMES_free>> names(
        static_cast<GENERAL_NAMES*>(
            X509_get_ext_d2i(certificate, NID_subject_alt_name, nullptr, nullptr)));
    std::vector<std::string> found;
    for (int i = 0; i < sk_GENERAL_NAME_num(names.get()); ++i) {
        const GENERAL_NAME* name = sk_GENERAL_NAME_value(names.get(), i);
        if (name->type == GEN_DNS) {
            const auto* bytes = ASN1_STRING_get0_data(name->d.dNSName);
            found.emplace_back(reinterpret_cast<const char*>(bytes),
                               static_cast<std::size_t>(ASN1_STRING_length(name->d.dNSName)));
        } else if (name->type == GEN_IPADD) {
            std::array<char, INET6_ADDRSTRLEN> text{};
            const bool v4 = ASN1_STRING_length(name->d.iPAddress) == 4;
            if (inet_ntop(v4 ? AF_INET : AF_INET6, ASN1_STRING_get0_data(name->d.iPAddress),
                          text.data(), text.size()) != nullptr)
                found.emplace_back(text.data());
        }
    }
    return alternative_names(found);
}

/// Makes the folder if it is missing, and then for this user alone. Returns whether it did.
Result<bool> make_folder(const fs::path& folder) {
    std::error_code error;
    fs::create_directories(folder.parent_path(), error);
    if (mkdir(folder.c_str(), 0700) == 0) return true;
    if (errno == EEXIST && fs::is_directory(folder, error)) return false;
    return fail(ErrorCode::io_failed, folder.string() + ": " + std::strerror(errno));
}

/// Writes files, by their names, into a folder that has none of them.
Result<void> write_new(const fs::path& folder,
                       const std::vector<std::pair<const char*, std::string>>& files) {
    const auto is_new = make_folder(folder);
    if (!is_new) return tl::unexpected(is_new.error());
    std::vector<NewFile> staged;
    for (const auto& [name, content] : files) {
        auto place = FilePlace::find(folder / name);
        if (!place) return tl::unexpected(place.error());
        if (place->exists())
            return fail(ErrorCode::io_failed, place->path().string() +
                                                  " exists, and is not overwritten; give another "
                                                  "DIR, or renew it: raynestd tls renew " +
                                                  folder.string());
        staged.push_back({std::move(*place), content, true});
    }
    auto written = write_files_atomically(staged);
    std::error_code ignored;
    if (!written && *is_new) fs::remove(folder, ignored);
    return written;
}

/// Returns the seconds until a certificate's time ends; negative after it.
Result<long> seconds_left(const X509* certificate) {
    int whole_days = 0;
    int seconds = 0;
    if (ASN1_TIME_diff(&whole_days, &seconds, nullptr, X509_get0_notAfter(certificate)) != 1)
        return failed("a certificate without an end");
    return whole_days * day_seconds + seconds;
}

/// A certificate and its key, as files of one folder hold them.
struct Pair {
    FilePlace place;  ///< the certificate's place
    Certificate certificate;
    Key key;
};

Result<FilePlace> find_existing(const fs::path& file, const std::string& if_missing) {
    auto place = FilePlace::find(file);
    std::error_code error;
    const bool is_missing = place ? !place->exists() : !fs::exists(file.parent_path(), error);
    if (is_missing)
        return fail(ErrorCode::io_failed, file.string() + ": it is missing; " + if_missing);
    return place;
}

Result<Pair> read_pair(const fs::path& folder, const char* certificate_file, const char* key_file,
                       Reader reader, const std::string& if_missing) {
    const auto certificate_place = find_existing(folder / certificate_file, if_missing);
    if (!certificate_place) return tl::unexpected(certificate_place.error());
    const auto key_place = find_existing(folder / key_file, if_missing);
    if (!key_place) return tl::unexpected(key_place.error());
    auto certificates = read_certificates(*certificate_place);
    if (!certificates) return tl::unexpected(certificates.error());
    auto key = read_key(*key_place, reader);
    if (!key) return tl::unexpected(key.error());
    Pair pair{*certificate_place, std::move(certificates->front()), std::move(*key)};
    const bool fits = X509_check_private_key(pair.certificate.get(), pair.key.get()) == 1;
    (void)tls_error_text();
    if (!fits)
        return fail(ErrorCode::io_failed, (folder / key_file).string() +
                                              ": this key does not belong to " + certificate_file +
                                              "; bring back the one that was made with it");
    return pair;
}

/// Fails unless the CA has signed the certificate for this use: the user of the daemon may have put
/// another in its place.
Result<void> check_signed(const Pair& pair, const Pair& ca, std::uint32_t use) {
    const bool is_ours = X509_verify(pair.certificate.get(), ca.key.get()) == 1;
    (void)tls_error_text();
    if (is_ours && (X509_get_extended_key_usage(pair.certificate.get()) & use) != 0) return {};
    return fail(ErrorCode::io_failed,
                pair.place.path().string() + ": " +
                    (is_ours ? "it was signed for another use" : "this CA has not signed it") +
                    ", and it is not renewed; bring the old one back, or make new ones in an empty "
                    "DIR: raynestd tls init DIR");
}

}  // namespace

std::vector<std::string> own_names() {
    std::set<std::string> names;
    std::array<char, 256> host{};
    if (gethostname(host.data(), host.size() - 1) == 0 && host[0] != '\0') {
        names.insert(host.data());
        addrinfo hints{};
        hints.ai_flags = AI_CANONNAME;
        addrinfo* found = nullptr;
        if (getaddrinfo(host.data(), nullptr, &hints, &found) == 0) {
            if (found != nullptr && found->ai_canonname != nullptr)
                names.insert(found->ai_canonname);
            freeaddrinfo(found);
        }
    }
    ifaddrs* interfaces = nullptr;
    if (getifaddrs(&interfaces) == 0) {
        for (const ifaddrs* at = interfaces; at != nullptr; at = at->ifa_next) {
            std::array<char, INET6_ADDRSTRLEN> text{};
            const int family = at->ifa_addr == nullptr ? AF_UNSPEC : at->ifa_addr->sa_family;
            const auto* v4 = reinterpret_cast<const sockaddr_in*>(at->ifa_addr);
            const auto* v6 = reinterpret_cast<const sockaddr_in6*>(at->ifa_addr);
            const bool usable =
                family == AF_INET || (family == AF_INET6 && !IN6_IS_ADDR_LINKLOCAL(&v6->sin6_addr));
            const void* bytes = family == AF_INET ? static_cast<const void*>(&v4->sin_addr)
                                                  : static_cast<const void*>(&v6->sin6_addr);
            if (usable && inet_ntop(family, bytes, text.data(), text.size()) != nullptr)
                names.insert(text.data());
        }
        freeifaddrs(interfaces);
    }
    for (const char* loopback : {"localhost", "127.0.0.1", "::1"}) names.insert(loopback);
    return {names.begin(), names.end()};
}

Result<void> make_certificates(const fs::path& folder, const std::vector<std::string>& names) {
    const Key ca_key(EVP_EC_gen("P-256")), server_key(EVP_EC_gen("P-256")),
        client_key(EVP_EC_gen("P-256"));
    if (!ca_key || !server_key || !client_key) return failed("cannot make a key");
    const auto ca = sign(
        ca_key.get(), "RayNest private CA", ca_days * day_seconds,
        {{NID_basic_constraints, "critical,CA:TRUE,pathlen:0"}, {NID_key_usage, ca_uses}}, nullptr);
    if (!ca) return tl::unexpected(ca.error());
    const Issuer issuer{ca->get(), ca_key.get()};
    const auto server = sign(server_key.get(), "raynestd", days * day_seconds,
                             server_extensions(alternative_names(names)), &issuer);
    if (!server) return tl::unexpected(server.error());
    const auto client =
        sign(client_key.get(), "raynest-client", days * day_seconds, client_extensions(), &issuer);
    if (!client) return tl::unexpected(client.error());

    using Files = CertificateFiles;
    return write_new(folder, {{Files::ca, to_pem(ca->get())},
                              {Files::ca_key, to_pem(ca_key.get())},
                              {Files::server, to_pem(server->get())},
                              {Files::server_key, to_pem(server_key.get())},
                              {Files::client, to_pem(client->get())},
                              {Files::client_key, to_pem(client_key.get())}});
}

Result<Renewal> renew_certificates(const fs::path& folder) {
    using Files = CertificateFiles;
    const auto ca = read_pair(
        folder, Files::ca, Files::ca_key, Reader::signer,
        "the CA signs anew: bring ca.pem and ca-key.pem back from where they are kept, or "
        "make another CA: raynestd tls init DIR");
    if (!ca) return tl::unexpected(ca.error());
    const auto left = seconds_left(ca->certificate.get());
    if (!left) return tl::unexpected(left.error());
    if (*left <= 0)
        return fail(ErrorCode::io_failed,
                    (folder / Files::ca).string() +
                        ": this CA has expired, and clients refuse what it "
                        "signs; make another: raynestd tls init DIR, and give "
                        "clients its ca.pem");
    const long seconds = std::min(days * day_seconds, *left);
    const Issuer issuer{ca->certificate.get(), ca->key.get()};
    std::vector<NewFile> renewed;
    const auto renew = [&](const char* file, const char* key_file, const std::string& common_name,
                           bool is_server) -> Result<void> {
        const auto old = read_pair(folder, file, key_file, Reader::command,
                                   "bring it back, or make new ones in an empty DIR: raynestd tls "
                                   "init DIR");
        if (!old) return tl::unexpected(old.error());
        if (auto good = check_signed(*old, *ca, is_server ? XKU_SSL_SERVER : XKU_SSL_CLIENT); !good)
            return good;
        const auto made =
            sign(old->key.get(), common_name, seconds,
                 is_server ? server_extensions(alternative_names(old->certificate.get()))
                           : client_extensions(),
                 &issuer);
        if (!made) return tl::unexpected(made.error());
        renewed.push_back({old->place, to_pem(made->get())});
        return {};
    };
    if (auto done = renew(Files::server, Files::server_key, "raynestd", true); !done)
        return tl::unexpected(done.error());
    if (auto done = renew(Files::client, Files::client_key, "raynest-client", false); !done)
        return tl::unexpected(done.error());
    if (auto written = write_files_atomically(renewed); !written)
        return tl::unexpected(written.error());
    return Renewal{seconds / day_seconds, seconds < days * day_seconds};
}

}  // namespace raynest::server
