// The materials of an OBJ.
#pragma once

#include "engine/assets/formats/file_content.h"
#include "engine/assets/input/uploaded_files.h"

#include <map>
#include <set>
#include <span>
#include <string>
#include <string_view>

namespace raynest {

/// Reads materials out of MTL files into `content`.
class MtlReader {
public:
    MtlReader(const ImportRequest& request, const ImportLimits& limits, FileContent& content)
        : limits_(limits),
          files_(request, limits.file_bytes_max),
          obj_(request.files.front().name),
          content_(content),
          image_bytes_left_(4 * limits.image_bytes_max) {}

    /// Reads the file that a line "mtllib" names. A file that is missing or outside the folder is
    /// left out with a warning. An error says which line of which file is wrong.
    Result<void> read(std::string_view name);
    /// Returns the index of a material; one without an MTL entry gets the default, and a warning.
    std::uint32_t find(std::string_view name);

private:
    Result<void> read_lines(const std::string& file, std::span<const std::byte> bytes);
    std::uint32_t texture(const std::string& mtl, std::string_view name);

    const ImportLimits& limits_;
    Upload files_;
    std::string obj_;
    FileContent& content_;
    std::uint64_t image_bytes_left_;
    std::set<std::string> read_;  ///< names of files
    std::map<std::string, std::uint32_t, std::less<>> materials_;
    std::map<std::string, std::uint32_t, std::less<>> textures_;
};

}  // namespace raynest
