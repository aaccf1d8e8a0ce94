#include "protocol/control.h"

#include "protocol/text.h"

#include <cstring>

namespace raynest::protocol {

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

std::span<const float> values(const wire::ParamTable& table) {
    const auto* list = table.values();
    return list == nullptr ? std::span<const float>() : std::span(list->data(), list->size());
}

Result<Frame> seal(const FrameHeader& header, const flatbuffers::FlatBufferBuilder& message,
                   const Limits& limits) {
    Frame frame;
    frame.header = header;
    frame.header.control_bytes = message.GetSize();
    const auto name = [&] {
        return std::string(wire::EnumNameMessage(static_cast<wire::Message>(header.type)));
    };
    if (message.GetSize() > limits.control_bytes_max)
        return fail(Code::limit_exceeded, name() + " takes " + std::to_string(message.GetSize()) +
                                              " bytes, over control_bytes_max");
    if (frame.header.frame_bytes() > limits.frame_bytes_max)
        return fail(Code::limit_exceeded, name() + " is over frame_bytes_max");
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
        clean_text(error.message.empty() ? info.remedy : error.message, Limits{}.text_bytes_max);
    message.retry_after_ms = error.retry_after_ms;
    message.closing = closing;
    return *encode(request_id, message);
}

}  // namespace raynest::protocol
