#include "engine/assets/formats/obj_names.h"

#include "engine/assets/formats/text_reader.h"
#include "engine/assets/gltf/file/uri.h"
#include "engine/assets/input/uploaded_files.h"

#include <algorithm>

namespace raynest {

std::optional<std::string> file_of_name(std::string_view by, std::string_view text) {
    if (text.starts_with('/') || text.starts_with('\\')) return std::nullopt;
    std::string uri(by.substr(0, by.rfind('/') + 1));  // "" without a folder
    uri += text;
    std::string encoded;
    for (const char letter : uri) {
        if (letter == '%')
            encoded += "%25";
        else
            encoded += letter;
    }
    return gltf::file_of_uri(encoded);
}

std::vector<std::string_view> files_of_mtllib(std::string_view words) {
    std::vector<std::string_view> files;
    TextReader text(std::as_bytes(std::span(words)));
    for (std::string_view word = text.word(); !word.empty(); word = text.word()) {
        if (!has_extension(word, ".mtl")) return {words};
        files.push_back(word);
    }
    return files;
}

std::string_view picture_of_map(std::string_view words) {
    TextReader text(std::as_bytes(std::span(words)));
    std::string_view rest = text.rest();
    while (rest.starts_with('-')) {
        text = TextReader(std::as_bytes(std::span(rest)));
        const std::string_view option = text.word();
        double ignored = 0;
        // Scale, offset and turbulence have one to three numbers, the others a fixed count.
        if (option == "-s" || option == "-o" || option == "-t" || option == "-mm") {
            for (int i = 0; i < (option == "-mm" ? 2 : 3) && text.number(ignored);) ++i;
        } else {
            text.word();
        }
        rest = text.rest();
    }
    return rest;
}

std::vector<std::string> files_named_by(std::string_view file, std::span<const std::byte> bytes,
                                        std::size_t names_max) {
    std::vector<std::string> names;
    const bool is_obj = has_extension(file, ".obj");
    if (!is_obj && !has_extension(file, ".mtl")) return names;
    for (TextReader text(bytes); !text.at_end() && names.size() < names_max; text.next_line()) {
        if (text.word() != (is_obj ? "mtllib" : "map_Kd")) continue;
        const std::string_view rest = text.rest();
        for (const std::string_view named :
             is_obj ? files_of_mtllib(rest) : std::vector{picture_of_map(rest)}) {
            auto name = file_of_name(file, named);
            if (name && std::find(names.begin(), names.end(), *name) == names.end())
                names.push_back(std::move(*name));
        }
    }
    return names;
}

}  // namespace raynest
