#include "engine/assets/formats/formats.h"

#include "engine/assets/input/uploaded_files.h"

#include <algorithm>
#include <array>

namespace raynest {
namespace {

constexpr std::array formats{
    FileFormat{".ply", read_ply}, FileFormat{".stl", read_stl},  FileFormat{".obj", read_obj},
    FileFormat{".off", read_off}, FileFormat{".npz", read_npz},  FileFormat{".las", read_las},
    FileFormat{".laz", read_laz}, FileFormat{".tif", read_tiff}, FileFormat{".tiff", read_tiff},
};

}  // namespace

const FileFormat* find_format(std::string_view source) {
    const auto* const format = std::find_if(
        formats.begin(), formats.end(),
        [&](const FileFormat& known) { return has_extension(source, known.extension); });
    return format == formats.end() ? nullptr : format;
}

std::string format_list() {
    std::string list;
    for (const FileFormat& format : formats) {
        if (format.read == read_laz || format.extension == ".tiff") continue;
        if (!list.empty()) list += ", ";
        list += format.extension;
    }
    return list;
}

}  // namespace raynest
