#include "server/http/websocket_messages.h"

#include "protocol/control.h"
#include "protocol/text.h"
#include "server/http/embedded.h"
#include "server/http/json_tokens.h"

#include <flatbuffers/idl.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <type_traits>
#include <utility>

namespace raynest::server {
namespace {

using flatbuffers::StructDef;
using flatbuffers::Type;
using protocol::Code;

/// Integers beyond it are written as text: JavaScript's numbers would round them.
constexpr std::uint64_t exact_integer_max = 1ULL << 53;
constexpr std::size_t type_bytes_max = 32;
constexpr std::size_t error_bytes_max = 200;

/// Writes tables as JSON. FlatBuffers' own generator rounds numbers to 6 or 12 decimals; this one
/// writes the shortest text that reads back the same.
class JsonWriter {
public:
    void table(const StructDef& type, const flatbuffers::Table& table) {
        text_ += '{';
        bool first = true;
        for (const flatbuffers::FieldDef* field : type.fields.vec) {
            const Type& of = field->value.type;
            const bool present = table.CheckField(field->value.offset);
            if (!present && !flatbuffers::IsScalar(of.base_type)) continue;
            name(field->name, first);
            if (flatbuffers::IsScalar(of.base_type))
                scalar(of, present ? table.GetAddressOf(field->value.offset) : nullptr,
                       field->value.constant);
            else if (flatbuffers::IsStruct(of))
                structure(*of.struct_def,
                          table.GetStruct<const std::uint8_t*>(field->value.offset));
            else
                reference(of, table.GetPointer<const std::uint8_t*>(field->value.offset));
        }
        text_ += '}';
    }

    std::string take() { return std::move(text_); }

private:
    void name(const std::string& field, bool& first) {
        if (!std::exchange(first, false)) text_ += ',';
        text_.append("\"").append(field).append("\":");
    }

    void structure(const StructDef& type, const std::uint8_t* data) {
        text_ += '{';
        bool first = true;
        for (const flatbuffers::FieldDef* field : type.fields.vec) {
            name(field->name, first);
            scalar(field->value.type, data + field->value.offset, field->value.constant);
        }
        text_ += '}';
    }

    /// Writes a text, a table or a list, at its own address.
    void reference(const Type& type, const std::uint8_t* data) {
        if (type.base_type == flatbuffers::BASE_TYPE_STRING)
            return string(*reinterpret_cast<const flatbuffers::String*>(data));
        if (type.base_type == flatbuffers::BASE_TYPE_STRUCT)
            return table(*type.struct_def, *reinterpret_cast<const flatbuffers::Table*>(data));
        const Type of = type.VectorType();
        const auto count = flatbuffers::ReadScalar<flatbuffers::uoffset_t>(data);
        data += sizeof(flatbuffers::uoffset_t);
        text_ += '[';
        for (flatbuffers::uoffset_t i = 0; i < count; ++i, data += flatbuffers::InlineSize(of)) {
            if (i != 0) text_ += ',';
            if (flatbuffers::IsScalar(of.base_type))
                scalar(of, data, {});
            else if (flatbuffers::IsStruct(of))
                structure(*of.struct_def, data);
            else
                reference(of, data + flatbuffers::ReadScalar<flatbuffers::uoffset_t>(data));
        }
        text_ += ']';
    }

    void string(const flatbuffers::String& value) {
        constexpr bool natural = true;
        const std::size_t before = text_.size();
        if (flatbuffers::EscapeString(value.c_str(), value.size(), &text_, false, natural)) return;
        text_.resize(before);
        const std::string clean = protocol::clean_text(value.string_view(), value.size());
        flatbuffers::EscapeString(clean.data(), clean.size(), &text_, false, natural);
    }

    /// Writes the scalar at `data`, or the default if that is null.
    void scalar(const Type& type, const std::uint8_t* data, const std::string& otherwise) {
        switch (type.base_type) {
            case flatbuffers::BASE_TYPE_BOOL:
                return static_cast<void>(
                    text_ += value<std::uint8_t>(data, otherwise) != 0 ? "true" : "false");
            case flatbuffers::BASE_TYPE_UCHAR:
                return number(type, value<std::uint8_t>(data, otherwise));
            case flatbuffers::BASE_TYPE_USHORT:
                return number(type, value<std::uint16_t>(data, otherwise));
            case flatbuffers::BASE_TYPE_UINT:
                return number(type, value<std::uint32_t>(data, otherwise));
            case flatbuffers::BASE_TYPE_ULONG:
                return number(type, value<std::uint64_t>(data, otherwise));
            case flatbuffers::BASE_TYPE_FLOAT:
                return number(type, value<float>(data, otherwise));
            case flatbuffers::BASE_TYPE_DOUBLE:
                return number(type, value<double>(data, otherwise));
            default:
                throw std::logic_error("messages.fbs has a field of a type without JSON");
        }
    }

    template <class Number>
    static Number value(const std::uint8_t* data, const std::string& otherwise) {
        if (data != nullptr) return flatbuffers::ReadScalar<Number>(data);
        Number number{};
        flatbuffers::StringToNumber(otherwise.c_str(), &number);
        return number;
    }

    template <class Number>
    void number(const Type& type, Number value) {
        std::array<char, 32> digits{};
        const auto* const end = std::to_chars(digits.begin(), digits.end(), value).ptr;
        const std::string_view text(digits.data(), static_cast<std::size_t>(end - digits.data()));
        bool plain = true;
        if constexpr (std::is_floating_point_v<Number>) {
            plain = std::isfinite(value);
        } else {
            plain = value <= exact_integer_max;
            const auto* const known =
                type.enum_def == nullptr
                    ? nullptr
                    : type.enum_def->ReverseLookup(static_cast<std::int64_t>(value));
            if (known != nullptr) return static_cast<void>(text_ += '"' + known->name + '"');
        }
        if (plain)
            text_ += text;
        else
            text_.append("\"").append(text).append("\"");
    }

    std::string text_;
};

Unreadable unreadable(const protocol::FrameHeader& header, Code code, std::string why) {
    return {header.type, header.request_id, {code, std::move(why), 0}, false};
}

tl::unexpected<Unreadable> malformed(Code code, std::string why) {
    return tl::unexpected<Unreadable>({0, 0, {code, std::move(why), 0}, true});
}

/// Returns 0 for an unknown name.
std::uint16_t type_named(std::string_view name) {
    for (std::size_t type = 1; type <= static_cast<std::size_t>(wire::Message::MAX); ++type)
        if (const auto number = static_cast<std::uint16_t>(type);
            protocol::message_known(number) && protocol::message_name(number) == name)
            return number;
    return 0;
}

/// Returns the parser's complaint without its "LINE: COLUMN: error: ".
std::string complaint(const std::string& error) {
    constexpr std::string_view mark = "error: ";
    const std::size_t at = error.find(mark);
    return protocol::clean_text(at == std::string::npos ? error : error.substr(at + mark.size()),
                                error_bytes_max);
}

/// The parser of messages.fbs. Reading that takes 0.7 ms, so there is one parser per thread.
class Schema {
public:
    Schema() {
        parser_.opts.strict_json = true;
        if (!parser_.Parse(embedded_file("protocol/messages.fbs").data()))
            throw std::logic_error("messages.fbs: " + parser_.error_);
    }
    static Schema& of_this_thread() {
        static thread_local Schema schema;
        return schema;
    }

    const StructDef& table(std::uint16_t type) const {
        return *parser_.LookupStruct("raynest.wire." + protocol::message_name(type));
    }

    /// Reads JSON as a message; false: error() says why not.
    bool read(const std::string& message, const char* json) {
        // A failed parser keeps the values that it had read, until it reads a schema.
        if (std::exchange(failed_, true)) (void)parser_.Parse("namespace raynest.wire;");
        parser_.SetRootType(("raynest.wire." + message).c_str());
        failed_ = !parser_.ParseJson(json);
        return !failed_;
    }
    [[nodiscard]] std::string error() const { return complaint(parser_.error_); }
    /// The message that was read.
    [[nodiscard]] const flatbuffers::FlatBufferBuilder& built() const { return parser_.builder_; }

private:
    flatbuffers::Parser parser_;
    bool failed_ = false;  ///< also if the last message ended with an exception
};

Read<protocol::Frame> read(protocol::FrameHeader header, std::string_view json) {
    protocol::Frame frame;
    frame.header = header;
    frame.header.control_bytes = 0;
    // The conversation answers other types, whatever they say.
    if (!protocol::sent_by_client(header.type)) return frame;
    const std::string name = protocol::message_name(header.type);
    const auto invalid = [&](std::string_view why) {
        return tl::unexpected(unreadable(
            header, Code::bad_frame, "the JSON of " + name + " is not valid: " + std::string(why)));
    };
    if (const auto fault = fault_of_json(json); !fault.empty()) return invalid(fault);
    Schema& schema = Schema::of_this_thread();
    if (!schema.read(name, std::string(json).c_str())) return invalid(schema.error());
    const flatbuffers::FlatBufferBuilder& built = schema.built();
    frame.header.control_bytes = built.GetSize();
    frame.control = protocol::Buffer(built.GetSize());
    std::memcpy(frame.control.data(), built.GetBufferPointer(), built.GetSize());
    return frame;
}

}  // namespace

Read<protocol::Frame> read_text_message(std::string_view message) {
    constexpr const char* form =
        "a text message is TYPE ID JSON, for example Info 3 {\"scene\":\"a\"}";
    const std::size_t first = message.find(' ');
    const std::size_t second =
        first == std::string_view::npos ? first : message.find(' ', first + 1);
    if (second == std::string_view::npos || first == 0 || first > type_bytes_max)
        return malformed(Code::bad_frame, form);
    protocol::FrameHeader header;
    const char* const id_end = message.data() + second;
    const auto [end, error] =
        std::from_chars(message.data() + first + 1, id_end, header.request_id);
    if (error != std::errc{} || end != id_end) return malformed(Code::bad_frame, form);
    const std::string_view name = message.substr(0, first);
    header.type = type_named(name);
    if (header.type == 0)
        return tl::unexpected(
            unreadable(header, Code::unknown_type,
                       "this daemon does not know " + protocol::clean_text(name, type_bytes_max)));
    return read(header, message.substr(second + 1));
}

Read<protocol::Frame> read_binary_message(const protocol::FrameHeader& header,
                                          std::string_view json) {
    return read(header, json);
}

std::string write_message(const protocol::FrameHeader& header, std::span<const std::byte> control) {
    JsonWriter writer;
    writer.table(Schema::of_this_thread().table(header.type),
                 *flatbuffers::GetRoot<flatbuffers::Table>(control.data()));
    const std::string json = writer.take();
    if (header.block_count == 0)
        return protocol::message_name(header.type) + ' ' + std::to_string(header.request_id) + ' ' +
               json;
    protocol::FrameHeader written = header;
    written.control_bytes = static_cast<std::uint32_t>(json.size());
    std::string head(protocol::header_bytes, '\0');
    protocol::write_header(written,
                           std::span<std::byte, protocol::header_bytes>(
                               reinterpret_cast<std::byte*>(head.data()), protocol::header_bytes));
    return head + json;
}

}  // namespace raynest::server
