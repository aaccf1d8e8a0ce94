#include "server/security/pem_file.h"

#include <openssl/pem.h>

namespace raynest::server {
namespace {

using Memory = std::unique_ptr<BIO, protocol::Release<BIO_free>>;

/// OpenSSL would ask for a password on the terminal: notes instead that it wanted one.
int refuse_password(char* /*buffer*/, int /*size*/, int /*writes*/, void* wanted) {
    *static_cast<bool*>(wanted) = true;
    return -1;
}

Memory over(const std::string& content) {
    return Memory(BIO_new_mem_buf(content.data(), static_cast<int>(content.size())));
}

Result<std::vector<Certificate>> to_certificates(const std::filesystem::path& file,
                                                 const Result<std::string>& content) {
    if (!content) return tl::unexpected(content.error());
    ERR_clear_error();
    std::vector<Certificate> found;
    const Memory memory = over(*content);
    while (X509* read =
               memory ? PEM_read_bio_X509_AUX(memory.get(), nullptr, nullptr, nullptr) : nullptr)
        found.emplace_back(read);
    // The end of the file is told as a missing first line.
    const bool is_end = ERR_GET_REASON(ERR_peek_last_error()) == PEM_R_NO_START_LINE;
    ERR_clear_error();
    if (found.empty())
        return unusable(file,
                        "there is no certificate in PEM form in it; make one with: raynestd "
                        "tls init DIR");
    if (!is_end)
        return unusable(file, "its certificate number " + std::to_string(found.size() + 1) +
                                  " is damaged; copy the file again");
    return found;
}

/// Overwrites the content.
Result<Key> to_key(const std::filesystem::path& file, Result<std::string> content) {
    if (!content) return tl::unexpected(content.error());
    ERR_clear_error();
    bool wants_password = false;
    const Memory memory = over(*content);
    Key read(memory
                 ? PEM_read_bio_PrivateKey(memory.get(), nullptr, refuse_password, &wants_password)
                 : nullptr);
    OPENSSL_cleanse(content->data(), content->size());
    ERR_clear_error();
    if (wants_password)
        return unusable(file,
                        "the key has a password, which nobody can be asked for; take it off: "
                        "openssl pkey -in " +
                            file.string() + " -out NEW, and give NEW mode 0600");
    if (!read) return unusable(file, "there is no key in PEM form in it");
    return read;
}

}  // namespace

tl::unexpected<Error> unusable(const std::filesystem::path& file, const std::string& why) {
    return fail(ErrorCode::io_failed, file.string() + ": " + why);
}

Result<std::vector<Certificate>> read_certificates(const std::filesystem::path& file) {
    return to_certificates(file, read_regular_file(file, pem_bytes_max, "let in whom they like"));
}

Result<std::vector<Certificate>> read_certificates(const FilePlace& place) {
    return to_certificates(place.path(), read_regular_file(place, pem_bytes_max));
}

Result<Key> read_key(const std::filesystem::path& file, Reader reader) {
    return to_key(file, read_secret_file(file, pem_bytes_max, reader));
}

Result<Key> read_key(const FilePlace& place, Reader reader) {
    return to_key(place.path(), read_secret_file(place, pem_bytes_max, reader));
}

}  // namespace raynest::server
