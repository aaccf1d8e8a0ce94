#include "engine/assets/formats/formats.h"
#include "engine/assets/formats/text_reader.h"

#include <cstring>

namespace raynest {
namespace {

constexpr std::size_t header_bytes = 84;  ///< 80 of any text, and the count of facets
constexpr std::size_t facet_bytes = 50;

void add_facet(FileGeometry& geometry) {
    const auto end = static_cast<std::uint32_t>(geometry.positions.size());
    geometry.rest.indices.insert(geometry.rest.indices.end(), {end - 3, end - 2, end - 1});
}

/// Some programs write an ASCII file in upper case.
std::string lower(std::string_view word) {
    std::string made(word);
    for (char& letter : made)
        if (letter >= 'A' && letter <= 'Z') letter = static_cast<char>(letter - 'A' + 'a');
    return made;
}

FileContent read_binary(std::span<const std::byte> facets, std::uint64_t count) {
    FileContent content;
    content.is_float32 = true;
    content.objects.push_back({{}, {FileGeometry{}}});
    FileGeometry& geometry = content.objects.back().geometries.back();
    geometry.positions.reserve(3 * count);
    geometry.rest.indices.reserve(3 * count);
    for (std::uint64_t i = 0; i < count; ++i) {
        float corners[9];  // behind a normal of three floats, which many programs leave 0
        std::memcpy(corners, facets.data() + i * facet_bytes + 12, sizeof corners);
        for (int corner = 0; corner < 3; ++corner)
            geometry.positions.emplace_back(corners[3 * corner], corners[3 * corner + 1],
                                            corners[3 * corner + 2]);
        add_facet(geometry);
    }
    return content;
}

Result<FileContent> read_text(std::span<const std::byte> bytes, const ImportLimits& limits) {
    FileContent content;
    TextReader text(bytes);
    std::size_t corners = 0;  // in the current facet
    while (!text.at_end()) {
        const std::string key = lower(text.word());
        if (key == "solid") {
            if (content.objects.size() >= limits.nodes_max)
                return text.refuse(fmt::format("the file has over {} solids", limits.nodes_max));
            content.objects.push_back({std::string(text.rest().substr(0, 256)), {FileGeometry{}}});
        } else if (content.objects.empty() && !key.empty()) {
            return text.refuse("the file does not begin with 'solid'");
        } else if (key == "vertex") {
            glm::dvec3 p;
            if (!text.number(p.x) || !text.number(p.y) || !text.number(p.z))
                return text.refuse(text.next_word() + " is no coordinate; a vertex has three");
            content.objects.back().geometries.back().positions.push_back(p);
            ++corners;
        } else if (key == "endfacet") {
            if (corners != 3)
                return text.refuse(fmt::format("the facet has {}; it must have 3",
                                               counted(corners, "vertex", "vertices")));
            add_facet(content.objects.back().geometries.back());
            corners = 0;
        } else if (key == "facet") {
            // The normal is unused: many programs leave it 0, or write "-1.#IND" for none.
            for (int i = 0; i < 4 && !text.is_line_end(); ++i) text.word();
        } else if (key != "outer" && key != "loop" && key != "endloop" && key != "endsolid" &&
                   !key.empty()) {
            return text.refuse(fmt::format("'{}' is no line of an STL file", one_line(key, 40)));
        }
        // Some programs write a whole facet in one line.
        if (key == "endsolid" || key.empty()) text.next_line();
    }
    if (corners != 0) return text.refuse("the file ends within a facet; it is cut short");
    if (content.objects.size() == 1) content.objects.front().name.clear();
    return content;
}

}  // namespace

Result<FileContent> read_stl(const ImportRequest& request, const ImportLimits& limits) {
    const std::span<const std::byte> bytes = request.files.front().bytes;
    const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    std::uint32_t count = 0;
    if (bytes.size() >= header_bytes) std::memcpy(&count, bytes.data() + 80, sizeof count);
    const std::uint64_t whole = header_bytes + std::uint64_t{count} * facet_bytes;
    // Binary files may begin with "solid" too: the length tells them apart.
    const bool is_binary = bytes.size() >= header_bytes && bytes.size() == whole;
    const std::size_t first = text.find_first_not_of(" \t\r\n\xEF\xBB\xBF");  // the mark of UTF-8
    if (!is_binary && first != std::string_view::npos && lower(text.substr(first, 5)) == "solid" &&
        text.substr(0, 1024).find('\0') == std::string_view::npos)
        return read_text(bytes, limits);
    if (bytes.size() < whole || bytes.size() < header_bytes) {
        return fail(ErrorCode::scene_invalid,
                    fmt::format("is neither an ASCII STL nor a whole binary one: it says that it "
                                "has {}, which take {} "
                                "bytes, and has {}; it is cut short",
                                counted(count, "facet", "facets"), whole, bytes.size()));
    }
    FileContent content = read_binary(bytes.subspan(header_bytes), count);
    if (bytes.size() > whole)
        content.warnings.push_back(fmt::format("{} behind the last facet are left out",
                                               counted(bytes.size() - whole, "byte", "bytes")));
    return content;
}

}  // namespace raynest
