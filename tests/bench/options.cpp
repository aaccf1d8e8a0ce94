#include "tests/bench/options.h"

#include <CLI/CLI.hpp>

#include <map>

namespace raynest::bench {
namespace {

std::string command_of(int argc, char** argv) {
    std::string text = "raynest-bench";
    for (int i = 1; i < argc; ++i) {
        const std::string word = argv[i];
        const bool plain = word.find_first_of(" ?&*;|<>()'\"$\\") == std::string::npos;
        text += plain ? " " + word : " '" + word + "'";
    }
    return text;
}

std::map<std::string, BuildQuality> qualities() {
    std::map<std::string, BuildQuality> all;
    for (std::size_t i = 0; i < build_quality_names.size(); ++i) {
        all[build_quality_names[i]] = static_cast<BuildQuality>(i);
    }
    return all;
}

}  // namespace

std::optional<Options> parse_options(int argc, char** argv, int& exit_code) {
    Options options;
    options.command = command_of(argc, argv);
    CLI::App app{
        "Rays per second of our variants, and ratios to a peer in the same process.\n"
        "Example: raynest-bench --scene gen:cards --intersector alpha_mask --peers embree-filter"};
    app.add_option("--scene,--soup,--inst", options.scene,
                   "gen:terrain|cards|forest1|forest3|forest3-flat|interior[?scale=S], "
                   "builtin:..., a .glb, .soup or .inst file");
    app.add_option("--over", options.over, "another form of the scene, raced on the same rays");
    app.add_option("--rays", options.rays,
                   "primary, ao, shadow, diffuse, random or a .rays file; several by commas")
        ->delimiter(',');
    app.add_option("--ref", options.ref, "a .ref file: expected closest hits of the .rays file");
    app.add_option("--kind", options.kind, "default: any for ao and shadow, else closest")
        ->check(CLI::IsMember({"auto", "closest", "any", "multi"}));
    app.add_option("--max-hits", options.hits_max, "of --kind multi")
        ->check(CLI::Range(1U, multi_hits_max));
    app.add_option("--traversal", options.traversals, "auto, single, stream, packet")
        ->delimiter(',');
    app.add_option("--intersector", options.intersectors, "")->delimiter(',');
    app.add_option("--counters", options.counters,
                   "none, total, level: what a heat map counts, by single rays")
        ->delimiter(',')
        ->check(CLI::IsMember({"none", "total", "level"}));
    app.add_option("--target", options.targets, "auto, v2, v3, v4")->delimiter(',');
    app.add_option("--threads", options.threads, "")->delimiter(',')->check(CLI::Range(1U, 256U));
    app.add_option("--peers", options.peers,
                   "embree, embree-packet, embree-coherent, embree-robust, embree-filter, "
                   "embree-filter-coherent, embree-argument, embree-list, embree-shrink, tinybvh, "
                   "tinybvh-hq; own: our first variant")
        ->delimiter(',');
    app.add_option("--pack-dir", options.pack_dirs, "more kernel packs");
    app.add_option("--count", options.count, "rays per set")->check(CLI::Range(1024U, 1U << 26));
    app.add_option("--rounds", options.rounds, "")->check(CLI::Range(1, 1000));
    app.add_flag("--build", options.build, "time and weigh the trees instead of tracing");
    app.add_option("--quality", options.qualities, "of --build: fast, medium, high")
        ->delimiter(',')
        ->transform(CLI::CheckedTransformer(qualities()));
    app.add_flag("--json", options.json, "one JSON object per row");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& error) {
        exit_code = app.exit(error) == 0 ? 0 : 2;
        return std::nullopt;
    }
    return options;
}

}  // namespace raynest::bench
