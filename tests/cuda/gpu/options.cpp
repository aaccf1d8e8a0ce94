#include "tests/cuda/gpu/options.h"

#include <CLI/CLI.hpp>

namespace raynest::bench {
namespace {

constexpr int exit_usage = 2;

template <class Options>
Parsed<Options> parse(CLI::App& app, const Options& options, int argc, const char* const* argv) {
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& error) {
        return {std::nullopt, app.exit(error) == 0 ? 0 : exit_usage};
    }
    return {options, 0};
}

}  // namespace

Parsed<CudaOptions> parse_cuda_options(int argc, const char* const* argv) {
    CudaOptions options;
    CLI::App app{"Compares a GPU with the CPU on one scene and one file of rays, and times it."};
    app.require_subcommand(1);
    CLI::App& check = *app.add_subcommand("check", "compare every variant with a CPU's pack");
    CLI::App& time = *app.add_subcommand("time", "time kernels alone, and with pinned memory");
    for (CLI::App* const command : {&check, &time}) {
        command->add_option("--pack", options.pack, "the device's pack")->required();
        command->add_option("--arena", options.arena, "a built scene")->required();
        command->add_option("--rays", options.rays, "a .rays file, random, or camera")->required();
        command->add_option("--count", options.count, "how many rays: repeats or samples a file")
            ->check(CLI::Range(0U, 1U << 24));
    }
    check.add_option("--chunk", options.chunk, "rays per slot")->check(CLI::Range(64U, 1U << 24));
    check.add_option("--cpu-pack", options.cpu_pack, "gives the expected bytes")->required();
    time.add_option("--rounds", options.rounds, "rounds in which all ways take turns")
        ->check(CLI::Range(1U, 1000U));
    auto parsed = parse(app, options, argc, argv);
    if (parsed.options) parsed.options->timing = time.parsed();
    return parsed;
}

Parsed<ArenaOptions> parse_arena_options(int argc, const char* const* argv) {
    ArenaOptions options;
    CLI::App app{"Writes a scene as an arena, and files of rays for it."};
    app.add_option("SCENE", options.source, "as raynest-bench --scene")->required();
    app.add_option("ARENA", options.arena, "the file to write")->required();
    app.add_option("--levels", options.levels, "merge instances until this many levels are left");
    app.add_option("--rays", options.rays, "KIND=FILE; separate several by commas")->delimiter(',');
    app.add_option("--count", options.count, "rays per file")->check(CLI::Range(1024U, 1U << 24));
    return parse(app, options, argc, argv);
}

}  // namespace raynest::bench
