#include "engine/assets/input/uploaded_files.h"

#include <algorithm>
#include <cctype>

namespace raynest {

bool has_extension(std::string_view source, std::string_view extension) {
    if (source.size() < extension.size()) return false;
    source.remove_prefix(source.size() - extension.size());
    return std::equal(source.begin(), source.end(), extension.begin(), [](char a, char b) {
        return std::tolower(static_cast<unsigned char>(a)) == b;
    });
}

Result<std::span<const std::byte>> Upload::read(std::string_view name) {
    // files[0] is the scene itself.
    const auto others = std::span(request_.files).subspan(1);
    const auto file = std::find_if(others.begin(), others.end(),
                                   [&](const NamedBytes& other) { return other.name == name; });
    if (file == others.end()) return std::span<const std::byte>();
    if (file->bytes.size() > bytes_left_) {
        return fail(ErrorCode::limit_exceeded, "the scene names the same file repeatedly");
    }
    bytes_left_ -= file->bytes.size();
    return file->bytes;
}

}  // namespace raynest
