// The shape of a fuzz target: one input in, no crash out.
//
// With clang a target links libFuzzer. With any compiler it also links replay.cpp, a main that
// mutates the target's own good inputs with a fixed seed and replays every given file, so that each
// ctest runs the same code.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace raynest::fuzz {

using Input = std::vector<std::uint8_t>;

/// Good inputs to start from; at least one.
std::vector<Input> seeds();

/// Ends the process if the condition is false, as a fuzzer expects for a finding.
inline void require(bool holds) {
    if (!holds) __builtin_trap();
}

}  // namespace raynest::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);
