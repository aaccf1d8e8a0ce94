// raynest-bench: rays per second of our variants, and their ratios to a peer in the same process.
//
//   raynest-bench --scene gen:terrain --rays primary,ao --peers embree,embree-coherent
//
// BENCH.md says how it measures. Never quote two figures of different runs.
#include "tests/bench/builds.h"
#include "tests/bench/contest.h"
#include "tests/bench/options.h"
#include "tests/bench/report.h"

#include <algorithm>
#include <filesystem>
#include <iostream>
#include <string_view>
#include <utility>

namespace raynest::bench {
namespace {

Result<Loaded> load(const Options& options) {
    Loaded loaded;
    std::vector<std::filesystem::path> pack_dirs = options.pack_dirs;
    if (const auto control = module_dir() / "control"; std::filesystem::exists(control)) {
        pack_dirs.push_back(control);
    }
    for (const std::string& target : options.targets) {
        auto registry = Registry::load({pack_dirs, target});
        if (!registry) return tl::unexpected(registry.error());
        loaded.registries.push_back(std::move(*registry));
    }
    if (std::any_of(options.peers.begin(), options.peers.end(),
                    [](const std::string& name) { return name != "own"; })) {
        std::string_view most;
        for (const auto& registry : loaded.registries)
            most = std::max<std::string_view>(most, registry->packs().front()->target);
        auto peers = load_peers(most);
        if (!peers) return tl::unexpected(peers.error());
        loaded.peers = std::move(*peers);
    }
    for (const std::string& name : options.peers) {
        const auto has = [&](const std::unique_ptr<PeerLibrary>& peer) {
            return std::ranges::any_of(peer->forms(),
                                       [&](const auto& form) { return form.name == name; });
        };
        const bool known = name == "own" || std::ranges::any_of(loaded.peers, has);
        if (!known)
            return fail(ErrorCode::param_invalid, "unknown peer '" + name + "': see --help");
    }
    std::erase_if(loaded.peers, [&](const std::unique_ptr<PeerLibrary>& peer) {
        return std::ranges::none_of(peer->forms(), [&](const PeerForm& form) {
            return std::ranges::find(options.peers, form.name) != options.peers.end();
        });
    });
    auto workload = load_workload(options.scene, *loaded.registries.front());
    if (!workload) return tl::unexpected(workload.error());
    loaded.workload = std::move(*workload);
    if (!options.over.empty()) {
        auto over = load_workload(options.over, *loaded.registries.front());
        if (!over) return tl::unexpected(over.error());
        loaded.over = std::move(*over);
    }
    return loaded;
}

/// False when a row's mismatches are beyond its limit.
Result<bool> run(const Options& options) {
    auto loaded = load(options);
    if (!loaded) return tl::unexpected(loaded.error());
    if (options.build) return race_builds(options, *loaded);
    print_header(options);
    bool within = true;
    for (const std::string& rays : options.rays) {
        const auto done = contest(options, *loaded, rays);
        if (!done) return done;
        within = within && *done;
    }
    return within;
}

constexpr int exit_threshold = 9;

/// Those of raynest: 2 usage, 5 scene, file or variant unknown or invalid, 1 all else.
int exit_code_of(ErrorCode code) {
    switch (code) {
        case ErrorCode::param_invalid:
            return 2;
        case ErrorCode::internal:
            return 1;
        default:
            return 5;
    }
}

}  // namespace
}  // namespace raynest::bench

int main(int argc, char** argv) {
    using namespace raynest::bench;
    int exit_code = 0;
    const auto options = parse_options(argc, argv, exit_code);
    if (!options) return exit_code;
    const auto done = run(*options);
    if (done && *done) return 0;
    if (done) {
        std::cerr << "raynest-bench: more answers differ than edges explain: see mismatches\n";
        return exit_threshold;
    }
    std::cerr << "raynest-bench: " << done.error().message << "\n";
    return exit_code_of(done.error().code);
}
