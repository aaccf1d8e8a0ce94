// Places of files that tests have made.
#pragma once

#include "server/security/secret_file.h"

#include <filesystem>
#include <stdexcept>

namespace raynest::server {

/// Throws where there is none.
inline FilePlace place_of(const std::filesystem::path& file) {
    auto place = FilePlace::find(file);
    if (!place) throw std::runtime_error(place.error().message);
    return *std::move(place);
}

}  // namespace raynest::server
