#include "client/files/exr_header.h"

#include "client/files/files.h"

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string_view>

namespace raynest::client {
namespace {

constexpr std::uint32_t exr_magic = 20000630;
/// The first pixels come after the header; a header of raynest is far smaller.
constexpr std::size_t exr_header_bytes_max = 1 << 20;
/// Longest name of an attribute or a type that OpenEXR allows.
constexpr std::size_t word_bytes_max = 255;
constexpr std::uint64_t file_bytes_max = 4ULL << 30;

class Reader {
public:
    explicit Reader(std::string_view bytes) : rest_(bytes) {}

    /// Takes a word that ends in a zero byte; false where none ends in time.
    bool word(std::string& out) {
        const std::size_t end = rest_.substr(0, word_bytes_max + 1).find('\0');
        if (end == std::string_view::npos) return false;
        out = rest_.substr(0, end);
        rest_.remove_prefix(end + 1);
        return true;
    }
    bool number(std::uint32_t& out) {
        if (rest_.size() < sizeof out) return false;
        std::memcpy(&out, rest_.data(), sizeof out);
        rest_.remove_prefix(sizeof out);
        return true;
    }
    bool bytes(std::uint32_t count, std::string_view& out) {
        if (rest_.size() < count) return false;
        out = rest_.substr(0, count);
        rest_.remove_prefix(count);
        return true;
    }

private:
    std::string_view rest_;
};

}  // namespace

Result<std::map<std::string, std::string>> read_exr_texts(std::span<const std::byte> file) {
    const std::size_t size = std::min(file.size(), exr_header_bytes_max);
    Reader reader({reinterpret_cast<const char*>(file.data()), size});
    std::map<std::string, std::string> texts;
    std::uint32_t magic = 0, version = 0, bytes = 0;
    if (!reader.number(magic) || magic != exr_magic || !reader.number(version))
        return fail(Exit::invalid, "is no EXR file");
    while (true) {
        std::string name, type;
        std::string_view value;
        if (!reader.word(name)) break;
        if (name.empty()) return texts;
        if (!reader.word(type) || !reader.number(bytes) || !reader.bytes(bytes, value)) break;
        if (type == "string") texts[name] = value;
    }
    return fail(Exit::invalid, "is an EXR file whose header is cut short or damaged");
}

Result<std::string> read_exr_range(const std::string& path, const std::string& metric,
                                   bool differs) {
    const auto file = read_file(path, file_bytes_max);
    if (!file) return tl::unexpected<Failure>(file.error());
    auto texts = read_exr_texts(file->span());
    if (!texts) return fail(Exit::invalid, shown_name(path) + ": " + texts.error().message);
    const auto range = texts->find("raynest:range");
    const auto of = texts->find("raynest:metric");
    if (range == texts->end() || of == texts->end())
        return fail(Exit::invalid, shown_name(path) +
                                       ": is no heat map of raynest: make one with "
                                       "raynest heatmap SCENE -o FILE.exr");
    if (of->second != metric)
        return fail(Exit::usage, shown_name(path) + ": its range is of --metric " + of->second +
                                     ", not of " + metric);
    // The range of a difference, and no other, begins below zero.
    if (differs != range->second.starts_with('-'))
        return fail(Exit::usage,
                    shown_name(path) + ": its range " + range->second +
                        (differs ? " is of counts, but --diff draws a difference: name an EXR "
                                   "that was made with --diff, or give --range=-N:N"
                                 : " is of a difference: name an EXR that was made without "
                                   "--diff, or give --range 0:N"));
    return range->second;
}

}  // namespace raynest::client
