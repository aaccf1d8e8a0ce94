#include "client/ground/json.h"

#include "client/ground/text.h"

#include <array>
#include <cstdio>

namespace raynest::client {

std::string json_text(const Json& value) {
    const std::string plain = value.dump(-1, ' ', false, Json::error_handler_t::replace);
    std::string text;
    for (std::size_t i = 0; i < plain.size(); ++i) {
        const auto byte = static_cast<unsigned char>(plain[i]);
        // In UTF-8, U+0080 to U+009F are C2 80 to C2 9F.
        const bool is_c1 = byte == 0xC2 && static_cast<unsigned char>(plain[i + 1]) < 0xA0;
        if (byte != 0x7F && !is_c1) {
            text += plain[i];
            continue;
        }
        if (is_c1) ++i;
        std::array<char, 8> escape{};
        std::snprintf(escape.data(), escape.size(), "\\u%04x",
                      static_cast<unsigned char>(plain[i]));
        text += escape.data();
    }
    return text;
}

Json shown_json(const Json& value) {
    if (value.is_string()) return shown_text(value.get<std::string>());
    if (!value.is_structured()) return value;
    Json shown = value.is_array() ? Json::array() : Json::object();
    for (const auto& item : value.items())
        if (value.is_array())
            shown.push_back(shown_json(item.value()));
        else
            shown[shown_text(item.key())] = shown_json(item.value());
    return shown;
}

}  // namespace raynest::client
