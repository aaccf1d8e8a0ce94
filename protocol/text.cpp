#include "protocol/text.h"

#include "protocol/validate.h"

#include <algorithm>
#include <charconv>
#include <system_error>

namespace raynest::protocol {

std::string clean_text(std::string_view text, std::size_t bytes_max) {
    std::string clean(text.substr(0, bytes_max));
    for (char& c : clean) {
        if (c == '\n' || c == '\r' || c == '\t') c = ' ';
        if ((c >= 0 && c < 0x20) || c == 0x7F) c = '?';
    }
    // A cut inside a letter leaves up to three bytes of it.
    for (int i = 0; i < 3 && text.size() > bytes_max && !printable(clean); ++i) clean.pop_back();
    if (!printable(clean))
        std::replace_if(
            clean.begin(), clean.end(), [](char c) { return c < 0; }, '?');
    return clean;
}

std::optional<char> percent_code(std::string_view text) {
    if (text.size() < 3 || text[0] != '%') return std::nullopt;
    unsigned char byte = 0;
    const char* const end = text.data() + 3;
    const auto read = std::from_chars(text.data() + 1, end, byte, 16);
    if (read.ec != std::errc{} || read.ptr != end) return std::nullopt;
    return static_cast<char>(byte);
}

}  // namespace raynest::protocol
