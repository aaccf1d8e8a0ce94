// Is this program slowed down, and its freed memory kept, by a sanitizer?
#pragma once

namespace raynest::test {

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool sanitized = true;
#else
inline constexpr bool sanitized = false;
#endif

/// `whole`, or the share of it that takes no longer under a sanitizer.
template <class Count>
constexpr Count sanitized_share(Count whole, Count divisor) {
    return sanitized ? whole / divisor : whole;
}

}  // namespace raynest::test
