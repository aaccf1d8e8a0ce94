// Counts of operator new, which allocation_test.cpp replaces for its program.
#pragma once

#include <cstddef>
#include <cstdint>

namespace raynest::test {

/// Largest allocation of this thread since a test set it to 0.
inline thread_local std::size_t largest_bytes = 0;
/// Bytes that this thread has allocated.
inline thread_local std::uint64_t allocated_bytes = 0;

}  // namespace raynest::test
