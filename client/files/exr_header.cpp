#include "client/files/exr_header.h"

#include "client/files/files.h"
#include "engine/assets/images/exr_attributes.h"

#include <algorithm>
#include <cstdint>

namespace raynest::client {
namespace {

/// The first pixels come after the header; a header of raynest is far smaller.
constexpr std::size_t exr_header_bytes_max = 1 << 20;
constexpr std::uint64_t file_bytes_max = 4ULL << 30;

}  // namespace

Result<std::map<std::string, std::string>> read_exr_texts(std::span<const std::byte> file) {
    ExrReader reader(file.first(std::min(file.size(), exr_header_bytes_max)));
    std::map<std::string, std::string> texts;
    if (reader.word() != exr_magic || !reader.word()) return fail(Exit::invalid, "is no EXR file");
    while (auto attribute = reader.attribute()) {
        if (attribute->name.empty()) return texts;
        if (!attribute->value) break;
        if (attribute->type == "string")
            texts[attribute->name].assign(reinterpret_cast<const char*>(attribute->value->data()),
                                          attribute->size);
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
