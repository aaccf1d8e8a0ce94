// Films are compared by their bytes.
#pragma once

#include "engine/integrators/film.h"

#include <cstddef>
#include <cstring>

namespace raynest::test {

inline bool same_bytes(const Film& a, const Film& b) {
    for (std::size_t i = 0; i < film_layers; ++i) {
        const auto left = a.words(static_cast<FilmLayer>(i));
        const auto right = b.words(static_cast<FilmLayer>(i));
        if (std::memcmp(left.data(), right.data(), left.size_bytes()) != 0) return false;
    }
    return true;
}

}  // namespace raynest::test
