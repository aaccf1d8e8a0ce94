// How much a test may do: is this program slowed down, and its freed memory kept, by a sanitizer?
// Is this the long run?
#pragma once

#include <cstdlib>

namespace raynest::test {

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool sanitized = true;
#else
inline constexpr bool sanitized = false;
#endif

/// An import's process has a sanitizer's memory besides its own, and all of it counts towards
/// --memory.
inline constexpr bool imports_grow = sanitized;

/// `whole`, or the share of it that takes no longer under a sanitizer.
template <class Count>
constexpr Count sanitized_share(Count whole, Count divisor) {
    return sanitized ? whole / divisor : whole;
}

/// `whole` where tests/run.sh was called with --long, else the usual share of it.
template <class Count>
Count usual_share(Count whole, Count divisor) {
    return std::getenv("RAYNEST_LONG") != nullptr ? whole : whole / divisor;
}

}  // namespace raynest::test
