#include "server/backends/cuda/scene_changes.h"

#include "engine/scene/format.h"

#include <algorithm>
#include <array>
#include <cstring>

namespace raynest::server::device {
namespace {

using format::Section;

/// By SceneArray.
constexpr std::array<Section, array_count> section_of{
    Section::nodes,     Section::blocks,    Section::records,
    Section::objects,   Section::instances, Section::geometries,
    Section::materials, Section::textures,  Section::attributes};

constexpr std::uint64_t element_bytes(std::uint32_t array) {
    return format::element_size[static_cast<std::size_t>(section_of[array])];
}

const format::SectionEntry& section(std::span<const std::byte> arena, std::uint32_t array) {
    const auto& header = *reinterpret_cast<const format::Header*>(arena.data());
    return header.sections[static_cast<std::size_t>(section_of[array])];
}

/// Bytes before the heads: their number.
constexpr std::size_t heads_at = sizeof(std::uint64_t);

std::uint64_t heads_bytes(std::uint64_t ranges) {
    return format::aligned(heads_at + ranges * sizeof(RangeHead));
}

}  // namespace

std::vector<RangeHead> changed_ranges(std::span<const std::byte> arena,
                                      const ArenaChanges& changed) {
    std::vector<RangeHead> ranges;
    changed.pages.for_each([&](std::uint64_t page) {
        for (std::uint32_t array = 0; array < array_count; ++array) {
            if ((changed.sections >> static_cast<std::uint32_t>(section_of[array]) & 1U) == 0)
                continue;
            const std::uint64_t element = element_bytes(array);
            const std::uint64_t begin = section(arena, array).offset;
            const std::uint64_t end = begin + section(arena, array).count * element;
            const std::uint64_t from = std::max(page, begin);
            const std::uint64_t to = std::min(page + PageSet::page_bytes, end);
            if (from >= to) continue;
            const std::uint64_t first = (from - begin) / element;
            const std::uint64_t last = (to - begin - 1) / element;
            const bool goes_on = !ranges.empty() && ranges.back().array == array &&
                                 ranges.back().first + ranges.back().count >= first;
            if (!goes_on) ranges.push_back({array, 0, first, 0});
            ranges.back().count = last + 1 - ranges.back().first;
        }
    });
    return ranges;
}

std::uint64_t changes_bytes(std::span<const RangeHead> ranges) {
    std::uint64_t bytes = heads_bytes(ranges.size());
    for (const RangeHead& range : ranges)
        bytes += format::aligned(range.count * element_bytes(range.array));
    return bytes;
}

std::vector<std::byte> changes_file(std::span<const std::byte> arena,
                                    std::span<const RangeHead> ranges) {
    std::vector<std::byte> file;
    file.reserve(changes_bytes(ranges));
    const auto append = [&](std::span<const std::byte> bytes) {
        file.insert(file.end(), bytes.begin(), bytes.end());
    };
    const std::uint64_t count = ranges.size();
    append(std::as_bytes(std::span(&count, 1)));
    append(std::as_bytes(ranges));
    file.resize(format::aligned(file.size()));
    for (const RangeHead& range : ranges) {
        const std::uint64_t element = element_bytes(range.array);
        append(arena.subspan(section(arena, range.array).offset + range.first * element,
                             range.count * element));
        file.resize(format::aligned(file.size()));
    }
    return file;
}

Result<std::vector<ChangedRange>> read_changes(std::span<const std::byte> file) {
    const auto bad = [](const char* why) { return fail(ErrorCode::field_invalid, why); };
    std::uint64_t ranges = 0;
    if (file.size() < sizeof ranges) return bad("the changes of a scene have no number of ranges");
    std::memcpy(&ranges, file.data(), sizeof ranges);
    if (ranges > changed_ranges_max) return bad("the changes of a scene are in too many ranges");
    std::uint64_t at = heads_bytes(ranges);
    if (at > file.size()) return bad("the changes of a scene end within their heads");
    std::vector<ChangedRange> changes(ranges);
    for (std::size_t i = 0; i < ranges; ++i) {
        RangeHead head;
        std::memcpy(&head, file.data() + heads_at + i * sizeof head, sizeof head);
        if (head.array >= array_count)
            return bad("the changes of a scene are in an array that no scene has");
        const std::uint64_t element = element_bytes(head.array);
        if (head.count > (file.size() - at) / element)
            return bad("the changes of a scene end within their elements");
        changes[i] = {head.array, head.first, head.count, file.data() + at};
        at += format::aligned(head.count * element);
        if (at > file.size()) return bad("the changes of a scene end within their elements");
    }
    if (at != file.size()) return bad("the changes of a scene go on behind their elements");
    return changes;
}

}  // namespace raynest::server::device
