#include "engine/assets/formats/formats.h"
#include "engine/assets/formats/shades.h"
#include "engine/assets/formats/text_reader.h"

namespace raynest {
Result<FileContent> read_off(const ImportRequest& request, const ImportLimits&) {
    const std::span<const std::byte> bytes = request.files.front().bytes;
    TextReader text(bytes);
    text.skip_comments('#');
    std::string_view kind = text.word();
    if (!kind.ends_with("OFF")) return text.refuse("does not begin with OFF");
    kind.remove_suffix(3);
    const std::string letters(kind);
    if (letters.find_first_not_of("CN") != std::string::npos)
        return text.refuse(fmt::format("'{}OFF' is not read: save it as OFF, COFF or NOFF",
                                       one_line(letters, 16)));
    const bool has_normals = letters.find('N') != std::string::npos;
    text.skip_comments('#');
    if (text.next_word() == "'BINARY'")
        return text.refuse("binary OFF is not read: save it as ASCII, or as PLY");
    std::int64_t vertices = 0, faces = 0, edges = 0;
    for (std::int64_t* count : {&vertices, &faces, &edges}) {
        text.skip_comments('#');
        // The count of edges is unused, and left out by some programs.
        if ((!text.whole(*count) || !text.is_word_end() || *count < 0) && count != &edges)
            return text.refuse(text.next_word() +
                               " is no count; OFF has those of vertices, faces and edges");
        if (count == &faces && text.is_line_end()) break;
    }
    text.next_line();
    const std::size_t left = bytes.size() - text.offset();
    constexpr std::int64_t vertex_bytes_min = 5, face_bytes_min = 2;
    if (vertices > static_cast<std::int64_t>(left + 1) / vertex_bytes_min ||
        faces > static_cast<std::int64_t>(left + 1) / face_bytes_min)
        return text.refuse(fmt::format(
            "says that it has {} vertices and {} faces, more than fit the file: it is cut short",
            vertices, faces));

    FileContent content;
    content.objects.push_back({{}, {FileGeometry{}}});
    FileGeometry& geometry = content.objects.back().geometries.back();
    geometry.positions.reserve(static_cast<std::size_t>(vertices));
    std::vector<double> row;
    std::vector<float> shades;
    for (std::int64_t i = 0; i < vertices; ++i) {
        text.skip_comments('#');
        row.clear();
        const std::size_t colour_at = has_normals ? 6 : 3;
        // The end of a line counts before the colour alone.
        while (row.size() < colour_at || !text.is_line_end()) {
            if (row.size() < colour_at) text.skip_comments('#');
            double value = 0;
            if (!text.number(value))
                return text.refuse(fmt::format("vertex {} of {} needs {} numbers; {} is none", i,
                                               vertices, colour_at, text.next_word()));
            if (row.size() < 16) row.push_back(value);
        }
        geometry.positions.emplace_back(row[0], row[1], row[2]);
        if (has_normals) geometry.rest.normals.push_back(Vec3(glm::dvec3(row[3], row[4], row[5])));
        if (row.size() < colour_at + 3) continue;
        shades.resize(4 * static_cast<std::size_t>(i), no_shade);
        row.resize(colour_at + 4, double{no_shade});
        for (std::size_t channel = 0; channel < 4; ++channel)
            shades.push_back(static_cast<float>(row[colour_at + channel]));
    }
    if (!shades.empty()) shades.resize(4 * geometry.positions.size(), no_shade);
    geometry.rest.colours = bytes_of_shades(shades);
    std::vector<std::uint32_t> corners, triangles;
    bool has_face_colours = false;
    for (std::int64_t i = 0; i < faces; ++i) {
        text.skip_comments('#');
        std::int64_t count = 0;
        if (!text.whole(count) || !text.is_word_end() || count < 0)
            return text.refuse(fmt::format("face {} of {}: {} is no count of corners", i, faces,
                                           text.next_word()));
        corners.clear();
        for (std::int64_t c = 0; c < count; ++c) {
            std::int64_t corner = 0;
            text.skip_comments('#');
            if (!text.whole(corner) || !text.is_word_end() || corner < 0 || corner >= vertices)
                return text.refuse(fmt::format("face {} of {} needs {} vertices from 0 to {}", i,
                                               faces, count, vertices - 1));
            corners.push_back(static_cast<std::uint32_t>(corner));
        }
        has_face_colours = has_face_colours || !text.is_line_end();
        text.next_line();
        if (corners.size() < 3) continue;
        triangles.clear();
        triangulate(geometry.positions, corners, triangles);
        for (const std::uint32_t place : triangles) geometry.rest.indices.push_back(corners[place]);
    }
    if (has_face_colours) content.warnings.emplace_back(face_colours_left_out);
    return content;
}

}  // namespace raynest
