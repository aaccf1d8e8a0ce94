#include "protocol/control.h"

#include <cstring>

namespace raynest::protocol {
namespace {

/// The text as validate() accepts it: on one line, cut to `bytes_max` between two letters.
std::string presentable(std::string_view text, std::size_t bytes_max) {
    std::string clean(text.substr(0, bytes_max));
    for (char& c : clean)
        if ((c >= 0 && c < 0x20) || c == 0x7F) c = ' ';
    // A cut may halve a letter of up to four bytes; what is foreign beyond that is shown as '?'.
    for (int halves = 0;
         halves < 3 && clean.size() == bytes_max - static_cast<std::size_t>(halves) &&
         !printable(clean);
         ++halves)
        clean.pop_back();
    if (!printable(clean))
        for (char& c : clean)
            if (c < 0) c = '?';
    return clean;
}

}  // namespace

bool message_known(std::uint16_t type) {
    return type <= static_cast<std::uint16_t>(wire::Message::MAX) && type != 0 &&
           *wire::EnumNameMessage(static_cast<wire::Message>(type)) != '\0';
}

std::string message_name(std::uint16_t type) {
    return message_known(type) ? wire::EnumNameMessage(static_cast<wire::Message>(type))
                               : "type " + std::to_string(type);
}

std::vector<std::string> strings(const StringList* list) {
    std::vector<std::string> out;
    if (list != nullptr)
        for (const flatbuffers::String* item : *list) out.push_back(item->str());
    return out;
}

Result<Frame> seal(wire::Message type, std::uint64_t request_id, const Bulk& bulk,
                   const flatbuffers::FlatBufferBuilder& message, const Limits& limits) {
    Frame frame;
    frame.header.type = static_cast<std::uint16_t>(type);
    frame.header.control_bytes = message.GetSize();
    frame.header.block_count = static_cast<std::uint32_t>(bulk.count());
    frame.header.bulk_bytes = bulk.bytes();
    frame.header.request_id = request_id;
    if (message.GetSize() > limits.control_bytes_max)
        return fail(Code::limit_exceeded, std::string(wire::EnumNameMessage(type)) + " takes " +
                                              std::to_string(message.GetSize()) +
                                              " bytes, over control_bytes_max");
    if (frame.header.frame_bytes() > limits.frame_bytes_max)
        return fail(Code::limit_exceeded,
                    std::string(wire::EnumNameMessage(type)) + " is over frame_bytes_max");
    frame.control = Buffer(message.GetSize());
    std::memcpy(frame.control.data(), message.GetBufferPointer(), message.GetSize());
    return frame;
}

Frame encode_error(std::uint64_t request_id, const Error& error, bool closing) {
    const ErrorInfo& info = error_info(error.code);
    wire::ErrorT message;
    message.code = static_cast<std::uint32_t>(info.code);
    message.name = info.name;
    message.message =
        presentable(error.message.empty() ? info.remedy : error.message, Limits{}.text_bytes_max);
    message.retry_after_ms = error.retry_after_ms;
    message.closing = closing;
    return *encode(request_id, message);
}

}  // namespace raynest::protocol
