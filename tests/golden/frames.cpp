// Frames of any message, opened, copied and written again.
#include "tests/golden/examples.h"

#include <algorithm>
#include <span>
#include <type_traits>

namespace raynest::golden {
namespace {

using protocol::Frame;
using protocol::Result;

/// Calls `use` with the table that a type of the header names.
template <class Use>
void visit(std::uint16_t type, Use use) {
    switch (type) {
#define RAYNEST_VISIT(number, Name) \
    case number:                    \
        return use(std::type_identity<wire::Name>{});
#define RAYNEST_REQUEST(number, Name, ...) RAYNEST_VISIT(number, Name)
#define RAYNEST_PART(number, Name, ...) RAYNEST_VISIT(number, Name)
#define RAYNEST_ANSWER(number, Name, ...) RAYNEST_VISIT(number, Name)
#include "protocol/lists/requests.def"
#undef RAYNEST_VISIT
        default:
            return;
    }
}

}  // namespace

Frame copy(const Frame& frame) {
    Frame result;
    result.header = frame.header;
    result.control = protocol::Buffer(frame.control.size());
    result.bulk = protocol::Buffer(frame.bulk.size());
    std::ranges::copy(frame.control.span(), result.control.data());
    std::ranges::copy(frame.bulk.span(), result.bulk.data());
    return result;
}

std::vector<std::byte> wire_bytes(const Frame& frame) {
    std::vector<std::byte> bytes(protocol::header_bytes);
    protocol::write_header(
        frame.header, std::span<std::byte, protocol::header_bytes>(bytes.data(), bytes.size()));
    for (const std::span<const std::byte> part : {frame.control.span(), frame.bulk.span()})
        bytes.insert(bytes.end(), part.begin(), part.end());
    return bytes;
}

Result<void> open_any(const Frame& frame) {
    Result<void> result =
        protocol::fail(protocol::Code::unknown_type, protocol::message_name(frame.header.type));
    visit(frame.header.type, [&]<class Table>(std::type_identity<Table>) {
        const auto opened = protocol::open<Table>(frame);
        result = opened ? Result<void>{} : tl::unexpected<protocol::Error>(opened.error());
    });
    return result;
}

Result<Frame> rewrite(const Frame& frame) {
    Result<Frame> result =
        protocol::fail(protocol::Code::unknown_type, protocol::message_name(frame.header.type));
    visit(frame.header.type, [&]<class Table>(std::type_identity<Table>) {
        typename Table::NativeTableType native;
        flatbuffers::GetRoot<Table>(frame.control.data())->UnPackTo(&native);
        result = protocol::encode(frame.header.request_id, native);
    });
    return result;
}

}  // namespace raynest::golden
