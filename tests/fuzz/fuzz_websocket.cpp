// Reads WebSocket messages as frames, text and binary, and runs the checks behind them. Writing the
// frame of a message and reading that again must give the same frame.
#include "protocol/limits.h"
#include "server/http/websocket_messages.h"
#include "tests/fuzz/target.h"
#include "tests/golden/examples.h"

#include <span>
#include <string>

using namespace raynest;

namespace {

/// As http.cpp does: a text message, or a binary one with its header.
server::Read<protocol::Frame> read(std::string_view message, bool is_text) {
    if (is_text) return server::read_text_message(message);
    const server::Unreadable unreadable{0, 0, {protocol::Code::bad_frame, "no frame", 0}, true};
    if (message.size() < protocol::header_bytes) return tl::unexpected(unreadable);
    const auto* bytes = reinterpret_cast<const std::byte*>(message.data());
    const auto header = protocol::read_header(
        std::span<const std::byte, protocol::header_bytes>(bytes, protocol::header_bytes),
        protocol::Limits{});
    if (!header || message.size() < protocol::header_bytes + header->control_bytes)
        return tl::unexpected(unreadable);
    return server::read_binary_message(
        *header, message.substr(protocol::header_bytes, header->control_bytes));
}

}  // namespace

std::vector<fuzz::Input> fuzz::seeds() {
    std::vector<Input> seeds;
    for (const golden::Example& example : golden::examples()) {
        const std::string text = server::write_message(
            example.frame.header, {example.frame.control.data(), example.frame.control.size()});
        Input seed{static_cast<std::uint8_t>(example.frame.header.block_count == 0)};
        seed.insert(seed.end(), text.begin(), text.end());
        seeds.push_back(std::move(seed));
    }
    return seeds;
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size == 0) return 0;
    const std::string_view message(reinterpret_cast<const char*>(data + 1), size - 1);
    const auto frame = read(message, (data[0] & 1U) != 0);
    if (!frame) {
        fuzz::require(!frame.error().error.message.empty());
        return 0;
    }
    if (!golden::open_any(*frame)) return 0;
    const std::string again =
        server::write_message(frame->header, {frame->control.data(), frame->control.size()});
    const auto same = read(again, frame->header.block_count == 0);
    fuzz::require(same.has_value() && same->header.type == frame->header.type &&
                  same->header.request_id == frame->header.request_id);
    return 0;
}
