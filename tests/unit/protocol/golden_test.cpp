// Golden bytes: version 1 means these bytes for ever. tests/golden/frames.hex holds one frame of
// every message; PROTOCOL.md shows some of them. Both are compared with freshly encoded frames and
// decoded.
#include "tests/golden/examples.h"

#include <doctest/doctest.h>

#include <cctype>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

using namespace raynest;

namespace {

using Dumps = std::map<std::string, std::vector<std::byte>>;

std::string read_text(const std::string& path) {
    std::ifstream file(std::string(RAYNEST_SOURCE_DIR) + "/" + path);
    REQUIRE_MESSAGE(file.good(), path);
    std::ostringstream text;
    text << file.rdbuf();
    return text.str();
}

/// Reads dumps of the shape
///   frame Query
///   0000  52 59 4e 31 ...  RYN1
/// where the two digits of each byte are followed by one blank, and two blanks end the bytes.
Dumps read_dumps(const std::string& text) {
    Dumps dumps;
    std::vector<std::byte>* current = nullptr;
    std::istringstream lines(text);
    for (std::string line; std::getline(lines, line);) {
        if (line.rfind("frame ", 0) == 0) {
            current = &dumps[line.substr(6)];
            continue;
        }
        const bool is_dump = line.size() > 8 &&
                             std::isxdigit(static_cast<unsigned char>(line[0])) &&
                             line.substr(4, 2) == "  ";
        if (current == nullptr || !is_dump) {
            current = nullptr;
            continue;
        }
        REQUIRE(std::stoul(line.substr(0, 4), nullptr, 16) == current->size());
        for (std::size_t at = 6; at + 1 < line.size() && line[at] != ' '; at += 3)
            current->push_back(static_cast<std::byte>(std::stoul(line.substr(at, 2), nullptr, 16)));
    }
    return dumps;
}

std::string dump(const std::string& name, const std::vector<std::byte>& bytes) {
    std::ostringstream out;
    out << "frame " << name << "\n" << std::hex;
    for (std::size_t row = 0; row < bytes.size(); row += 16) {
        const auto put = [&](std::size_t value, int digits) {
            for (int digit = digits - 1; digit >= 0; --digit)
                out << "0123456789abcdef"[value >> (4 * digit) & 15];
        };
        put(row, 4);
        out << " ";
        std::string letters;
        for (std::size_t i = row; i < row + 16; ++i) {
            out << " ";
            if (i >= bytes.size()) {
                out << "  ";
                continue;
            }
            const auto value = static_cast<unsigned char>(bytes[i]);
            put(value, 2);
            letters += value > 0x20 && value < 0x7F ? static_cast<char>(value) : '.';
        }
        out << "  " << letters << "\n";
    }
    return out.str();
}

/// The frame decodes and opens as what it is called.
void check_decodes(const std::string& name, const std::vector<std::byte>& bytes) {
    const protocol::Limits limits;
    protocol::FrameDecoder decoder(limits);
    REQUIRE(decoder.feed(bytes).value() == bytes.size());
    REQUIRE(decoder.complete());
    const protocol::Frame frame = decoder.take();
    CHECK(protocol::message_name(frame.header.type) == name.substr(0, name.find(' ')));
    CHECK(golden::open_any(frame));
}

void check_against_examples(const Dumps& dumps) {
    std::map<std::string, std::vector<std::byte>> fresh;
    for (const golden::Example& example : golden::examples())
        fresh[example.name] = golden::wire_bytes(example.frame);
    for (const auto& entry : dumps) {
        const std::string& name = entry.first;
        const std::vector<std::byte>& bytes = entry.second;
        CAPTURE(name);
        check_decodes(name, bytes);
        CHECK_MESSAGE(fresh[name] == bytes, "\nfreshly encoded:\n" << dump(name, fresh[name]));
    }
}

}  // namespace

TEST_CASE("one frame of every message has its golden bytes") {
    const Dumps dumps = read_dumps(read_text("tests/golden/frames.hex"));
    for (const golden::Example& example : golden::examples())
        CHECK_MESSAGE(dumps.contains(example.name), "\nadd:\n"
                                                        << dump(example.name,
                                                                golden::wire_bytes(example.frame)));
    check_against_examples(dumps);
}

TEST_CASE("the dumps of PROTOCOL.md are frames of this protocol") {
    const Dumps dumps = read_dumps(read_text("protocol/PROTOCOL.md"));
    CHECK(dumps.size() >= 5);
    check_against_examples(dumps);
}

TEST_CASE("PROTOCOL.md lists every message, error and limit with its number") {
    const std::string page = read_text("protocol/PROTOCOL.md");
    const auto check_row = [&](const std::string& row) {
        CHECK_MESSAGE(page.find(row) != std::string::npos, row);
    };
    for (const golden::Example& example : golden::examples()) {
        const std::uint16_t type = example.frame.header.type;
        const std::string name = protocol::message_name(type);
        check_row(name + (name == "Credit" ? " (both ways)" : "") + " | " + std::to_string(type) +
                  " |");
    }
    for (const protocol::ErrorInfo& info : protocol::error_table())
        check_row("| " + std::to_string(static_cast<unsigned>(info.code)) + " | " +
                  std::string(info.name) + " | " + std::to_string(static_cast<int>(info.exit)) +
                  " | " + std::string(info.remedy) + " |");
    const protocol::Limits limits;
    for (const protocol::LimitInfo& info : protocol::limit_table())
        check_row("| `" + std::string(info.name) + "` | " + std::to_string(limits.*info.value) +
                  " | " + std::string(info.text) + " |");
}
