// raynest-bench-cuda: one scene and one file of rays on a GPU: equal to the CPU, and how fast.
//
//   raynest-bench-cuda check --pack CUDA.so --cpu-pack V3.so --arena F.arena --rays F.rays
//   raynest-bench-cuda time  --pack CUDA.so --arena F.arena --rays F.rays
//
// For a bare machine: it needs the packs and a driver, no library of others, and reads arenas that
// raynest-bench-bake wrote. Exit codes: 0; 1 something failed; 2 a wrong argument; 9 answers
// differ; 77 there is no GPU.
#include "engine/bvh/pages.h"
#include "engine/math/random.h"
#include "engine/scene/arena_check.h"
#include "tests/bench/files.h"
#include "tests/bench/rays.h"
#include "tests/cuda/gpu/measure.h"

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include <cstring>
#include <exception>
#include <filesystem>
#include <iostream>

namespace raynest::bench {
namespace {

constexpr int exit_failed = 1;
constexpr int exit_differs = 9;
constexpr int exit_no_device = 77;

struct Options {
    bool timing = false;
    std::string pack, cpu_pack, arena, rays;
    std::uint32_t count = 0;  ///< 0: as many as the file has
    std::uint32_t chunk = 1U << 17;
    std::uint32_t rounds = 11;
};

template <class T>
T value_of(Result<T> result) {
    if (!result) throw std::runtime_error(result.error().message);
    return std::move(*result);
}

/// Aligned as a view needs it.
Pages read_arena(const std::string& path) {
    const std::vector<std::byte> bytes = value_of(read_file(path));
    Pages arena(bytes.size());
    std::memcpy(arena.data(), bytes.data(), bytes.size());
    return arena;
}

std::vector<Ray> make_rays(const Options& options, const Box& bounds) {
    if (options.rays == "random") {
        Random random(17);
        return random_rays(bounds, options.count, random);
    }
    return value_of(read_rays(options.rays));
}

int run(const Options& options) {
    const Pages arena = read_arena(options.arena);
    const SceneView scene = value_of(check_arena({arena.data(), arena.size()}));
    const std::vector<Ray> rays = make_rays(options, scene.objects[scene.root].bounds);
    if (rays.empty()) throw std::runtime_error(options.rays + " rays: none; say --count");
    const OpenDevice device(options.pack);

    Work work{scene, rays, options.count, options.chunk, {}};
    if (work.count == 0) work.count = static_cast<std::uint32_t>(rays.size());
    work.print = [&](const nlohmann::ordered_json& more) {
        nlohmann::ordered_json row{{"what", options.timing ? "time" : "check"},
                                   {"device", device.info().name},
                                   {"scene", std::filesystem::path(options.arena).stem().string()},
                                   {"rays", std::filesystem::path(options.rays).stem().string()},
                                   {"count", work.count}};
        row.update(more);
        std::cout << row.dump() << std::endl;
    };
    if (!options.timing) return check(device, open_pack(options.cpu_pack), work) ? 0 : exit_differs;
    time(device, work, options.rounds);
    return 0;
}

}  // namespace
}  // namespace raynest::bench

int main(int argc, char** argv) {
    using namespace raynest::bench;
    Options options;
    CLI::App app{"One scene and one file of rays on a GPU: equal to the CPU, and how fast."};
    app.require_subcommand(1);
    CLI::App& check = *app.add_subcommand("check", "every variant against a CPU's pack");
    CLI::App& time = *app.add_subcommand("time", "kernels alone, and between pinned memory");
    for (CLI::App* const command : {&check, &time}) {
        command->add_option("--pack", options.pack, "the device's pack")->required();
        command->add_option("--arena", options.arena, "a baked scene")->required();
        command->add_option("--rays", options.rays, "a .rays file, or random")->required();
        command->add_option("--count", options.count, "those of a file over and over, or a share")
            ->check(CLI::Range(0U, 1U << 24));
        command->add_option("--chunk", options.chunk, "rays of a slot")
            ->check(CLI::Range(64U, 1U << 24));
    }
    check.add_option("--cpu-pack", options.cpu_pack, "whose bytes are expected")->required();
    time.add_option("--rounds", options.rounds, "")->check(CLI::Range(1U, 1000U));
    try {
        app.parse(argc, argv);
        options.timing = time.parsed();
        return run(options);
    } catch (const CLI::ParseError& error) {
        return app.exit(error) == 0 ? 0 : 2;
    } catch (const NoDevice& error) {
        std::cerr << "raynest-bench-cuda: no GPU: " << error.what() << "\n";
        return exit_no_device;
    } catch (const std::exception& error) {
        std::cerr << "raynest-bench-cuda: " << error.what() << "\n";
        return exit_failed;
    }
}
