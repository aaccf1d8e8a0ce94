// The table under construction; private to malformed*.cpp.
#pragma once

#include "tests/golden/examples.h"
#include "tests/golden/malformed.h"

#include <string>
#include <utility>
#include <vector>

namespace raynest::golden {

using protocol::Code;
using protocol::Frame;
using protocol::FrameHeader;

class Table {
public:
    /// Framing is lost: the answer closes.
    void lost(std::string name, std::vector<std::byte> bytes, Code code) {
        rows_.push_back({std::move(name), std::move(bytes), code, true, false});
    }
    void lost(const std::string& name, const FrameHeader& header, Code code) {
        Frame frame;
        frame.header = header;
        lost(name, wire_bytes(frame), code);
    }
    /// The frame ends where it says: the connection goes on.
    void kept(std::string name, const Frame& frame, Code code) {
        const auto type = static_cast<wire::Message>(frame.header.type);
        const bool follows = type == wire::Message::QueryRays || type == wire::Message::Upload ||
                             type == wire::Message::Credit || type == wire::Message::Cancel;
        rows_.push_back({std::move(name), wire_bytes(frame), code, false, follows});
    }
    /// A good message, spoilt: `spoil` changes the native message before it is encoded.
    template <class Native>
    void spoilt(const std::string& name, Native message, Code code) {
        // Encoded under limits that let the overlong through.
        protocol::Limits generous;
        generous.control_bytes_max = ~0ULL;
        kept(name, protocol::encode(query_id, message, generous).value(), code);
    }
    std::vector<Malformed> take() { return std::move(rows_); }

private:
    std::vector<Malformed> rows_;
};

/// Requests of sound bytes whose contents are out of bounds (malformed_messages.cpp).
void add_malformed_messages(Table& table);

}  // namespace raynest::golden
