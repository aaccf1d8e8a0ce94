// main() of a fuzz target without libFuzzer: `replay_x [ROUNDS] [FILE|FOLDER]...`, or
// `replay_x --seeds FOLDER`, which writes the target's own inputs there as libFuzzer's start.
#include "tests/fuzz/target.h"

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <random>
#include <string>

namespace {

using raynest::fuzz::Input;

/// Applies a few mutations: flip a bit, set a byte to an extreme, cut, repeat a range, overwrite a
/// range with another seed's.
Input mutate(Input input, const Input& other, std::mt19937& random) {
    const auto below = [&](std::size_t n) { return n == 0 ? 0 : random() % n; };
    for (std::size_t rounds = 1 + below(4); rounds > 0 && !input.empty(); --rounds) {
        const std::size_t at = below(input.size());
        switch (below(5)) {
            case 0:
                input[at] = static_cast<std::uint8_t>(input[at] ^ (1U << below(8)));
                break;
            case 1: {
                constexpr std::uint8_t extremes[] = {0, 1, 0x7F, 0x80, 0xFF};
                input[at] = extremes[below(5)];
                break;
            }
            case 2:
                input.resize(at);
                break;
            case 3: {
                const Input stretch(input.begin() + static_cast<std::ptrdiff_t>(at), input.end());
                input.insert(input.end(), stretch.begin(), stretch.end());
                break;
            }
            default:
                for (std::size_t i = 0; i < 8 && at + i < input.size() && !other.empty(); ++i)
                    input[at + i] = other[below(other.size())];
        }
    }
    return input;
}

std::size_t replay_file(const std::filesystem::path& path) {
    std::ifstream file(path, std::ios::binary);
    const Input input{std::istreambuf_iterator<char>(file), {}};
    LLVMFuzzerTestOneInput(input.data(), input.size());
    return 1;
}

std::size_t replay(const std::filesystem::path& path) {
    if (!std::filesystem::is_directory(path)) return replay_file(path);
    std::size_t count = 0;
    for (const auto& entry : std::filesystem::directory_iterator(path))
        if (entry.is_regular_file()) count += replay_file(entry.path());
    return count;
}

int write_seeds(const std::filesystem::path& folder) {
    std::size_t count = 0;
    for (const Input& seed : raynest::fuzz::seeds()) {
        std::ofstream file(folder / ("seed-" + std::to_string(count++)), std::ios::binary);
        file.write(reinterpret_cast<const char*>(seed.data()),
                   static_cast<std::streamsize>(seed.size()));
        if (!file) return EXIT_FAILURE;
    }
    return EXIT_SUCCESS;
}

}  // namespace

int main(int argc, char** argv) {
    if (argc == 3 && argv[1] == std::string("--seeds")) return write_seeds(argv[2]);
    const std::size_t rounds = argc > 1 ? std::stoul(argv[1]) : 100000;
    std::size_t files = 0;
    for (int i = 2; i < argc; ++i) {
        if (!std::filesystem::exists(argv[i])) {
            std::cerr << argv[i] << " does not exist\n";
            return EXIT_FAILURE;
        }
        files += replay(argv[i]);
    }

    const std::vector<Input> seeds = raynest::fuzz::seeds();
    std::mt19937 random(20240229);
    for (const Input& seed : seeds) LLVMFuzzerTestOneInput(seed.data(), seed.size());
    for (std::size_t round = 0; round < rounds; ++round) {
        const Input& seed = seeds[random() % seeds.size()];
        const Input input = mutate(seed, seeds[random() % seeds.size()], random);
        LLVMFuzzerTestOneInput(input.data(), input.size());
    }
    std::cout << seeds.size() << " seeds, " << rounds << " mutations, " << files << " files\n";
    return seeds.empty() ? EXIT_FAILURE : EXIT_SUCCESS;
}
