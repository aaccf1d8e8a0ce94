#include "client/files/obj_names.h"

#include "client/files/files.h"
#include "client/files/gltf_names.h"

#include <algorithm>

namespace raynest::client {
namespace {

constexpr std::string_view blanks = " \t\v\f";

/// Takes the first word off a line.
std::string_view take_word(std::string_view& line) {
    line.remove_prefix(std::min(line.find_first_not_of(blanks), line.size()));
    const std::string_view word = line.substr(0, line.find_first_of(blanks));
    line.remove_prefix(word.size());
    line.remove_prefix(std::min(line.find_first_not_of(blanks), line.size()));
    return word;
}

bool is_number(std::string_view word) {
    return !word.empty() && word.find_first_not_of("+-.0123456789eE") == std::string_view::npos;
}

/// Returns what stands behind the options of a map, as in "-s 2 2 1 leaf.png".
std::string_view without_options(std::string_view line) {
    while (line.starts_with('-')) {
        const std::string_view option = take_word(line);
        const bool is_list = option == "-s" || option == "-o" || option == "-t" || option == "-mm";
        if (!is_list) take_word(line);
        for (int i = 0; is_list && i < (option == "-mm" ? 2 : 3); ++i) {
            std::string_view rest = line;
            if (!is_number(take_word(rest))) break;
            line = rest;
        }
    }
    return line;
}

/// The files of the words behind "mtllib": each word where all of them end in ".mtl", else one
/// file whose name has blanks.
std::vector<std::string_view> files_of_mtllib(std::string_view words) {
    std::vector<std::string_view> files;
    for (std::string_view rest = words; !rest.empty();)
        if (files.push_back(take_word(rest)); extension_of(std::string(files.back())) != ".mtl")
            return {words};
    return files;
}

}  // namespace

std::optional<std::string> file_of_name(std::string_view by, std::string_view text) {
    if (text.starts_with('/') || text.starts_with('\\')) return std::nullopt;
    std::string whole(by.substr(0, by.rfind('/') + 1));
    whole += text;
    std::string uri;
    for (const char letter : whole) {
        if (letter == '%')
            uri += "%25";
        else
            uri += letter;
    }
    return file_of_uri(uri);
}

std::vector<std::string> obj_names(std::string_view file, std::span<const std::byte> bytes) {
    std::vector<std::string> names;
    const std::string ending = extension_of(std::string(file));
    if (ending != ".obj" && ending != ".mtl") return names;
    const std::string_view wanted = ending == ".obj" ? "mtllib" : "map_Kd";
    std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    // The mark that Windows programs write before UTF-8 is no part of the text.
    if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
    for (std::size_t at = text.find(wanted); at != std::string_view::npos;
         at = text.find(wanted, at + 1)) {
        const std::size_t before = text.substr(0, at).find_last_not_of(blanks);
        if (before != std::string_view::npos && text[before] != '\n' && text[before] != '\r')
            continue;
        std::string_view line = text.substr(at);
        line = line.substr(0, line.find_first_of("\r\n"));
        if (take_word(line) != wanted) continue;
        line = line.substr(0, line.find_last_not_of(blanks) + 1);
        for (const std::string_view named :
             ending == ".obj" ? files_of_mtllib(line) : std::vector{without_options(line)}) {
            auto name = file_of_name(file, named);
            if (name && std::ranges::find(names, *name) == names.end())
                names.push_back(std::move(*name));
        }
    }
    return names;
}

}  // namespace raynest::client
