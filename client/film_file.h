// The header of an EXR that the daemon made of a lit picture: the request, as text.
#pragma once

#include "client/failure.h"

#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <string>

namespace raynest::client {

struct FilmFile {
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::map<std::string, std::string> attributes;  ///< of type string, without "raynest:"

    /// The value of an attribute; "" where there is none.
    [[nodiscard]] std::string value(const std::string& name) const;
};

/// Reads the header alone; the daemon reads it again, and the pixels. `name` is for messages.
Result<FilmFile> read_film_file(std::span<const std::byte> file, const std::string& name);

}  // namespace raynest::client
