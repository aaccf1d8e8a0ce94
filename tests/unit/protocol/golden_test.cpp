// Golden bytes: version 1 means these bytes for ever. tests/golden/frames.hex holds one frame of
// every message, which is compared with a newly encoded one and decoded. The dumps of PROTOCOL.md
// are decoded here; tests/integration/conversation_test.py plays them to a daemon.
#include "tests/golden/examples.h"

#include <doctest/doctest.h>

#include <cctype>
#include <fstream>
#include <map>
#include <set>
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

/// Reads dumps of the form
///   frame Query
///   0000  52 59 4e 31 ...  RYN1
/// where one blank follows the two digits of each byte, and two blanks end the bytes.
Dumps read_dumps(const std::string& text) {
    Dumps dumps;
    std::string name;
    std::istringstream lines(text);
    for (std::string line; std::getline(lines, line);) {
        if (line.rfind("frame ", 0) == 0) {
            name = line.substr(6);
            continue;
        }
        const bool is_dump = line.size() > 8 &&
                             std::isxdigit(static_cast<unsigned char>(line[0])) &&
                             line.substr(4, 2) == "  ";
        if (name.empty() || !is_dump) {
            name.clear();
            continue;
        }
        std::vector<std::byte>& bytes = dumps[name];
        REQUIRE(std::stoul(line.substr(0, 4), nullptr, 16) == bytes.size());
        for (std::size_t at = 6; at + 1 < line.size() && line[at] != ' '; at += 3)
            bytes.push_back(static_cast<std::byte>(std::stoul(line.substr(at, 2), nullptr, 16)));
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

/// Checks that the frame decodes and opens as the message of this name.
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
    for (const auto& [name, bytes] : dumps) {
        CAPTURE(name);
        check_decodes(name, bytes);
    }
}

TEST_CASE("every message of requests.def has an example") {
    std::set<std::uint16_t> shown;
    for (const golden::Example& example : golden::examples())
        shown.insert(example.frame.header.type);
#define RAYNEST_REQUEST(number, Name, ...) CHECK_MESSAGE(shown.contains(number), #Name);
#define RAYNEST_PART(number, Name, ...) CHECK_MESSAGE(shown.contains(number), #Name);
#define RAYNEST_ANSWER(number, Name, ...) CHECK_MESSAGE(shown.contains(number), #Name);
#include "protocol/lists/requests.def"
}
