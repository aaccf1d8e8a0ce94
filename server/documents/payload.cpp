#include "server/documents/payload.h"

#include <cstring>

namespace raynest::server {

Payload json_payload(std::uint32_t width, std::uint32_t height, std::string_view text) {
    Payload payload{width, height, std::vector<std::byte>(text.size())};
    std::memcpy(payload.bytes.data(), text.data(), text.size());
    return payload;
}

}  // namespace raynest::server
