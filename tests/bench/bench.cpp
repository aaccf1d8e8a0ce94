// raynest-bench: rays per second of a variant, and its ratio to a peer in the same process.
//
//   raynest-bench --scene builtin:forest --rays primary,ao --peers embree
//
// Ours and the peer's rounds alternate; times are those of the thread's CPU clock; the ratio is the
// median over rounds; both sides flush denormals. Before any timing the answers are compared on all
// rays. Never quote two figures of different runs.
#include "engine/packs/registry.h"
#include "tests/bench/peer.h"
#include "tests/bench/workload.h"

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <time.h>
#include <xmmintrin.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <memory>
#include <sstream>
#include <thread>
#include <vector>

namespace raynest::bench {
namespace {

struct Options {
    std::string scene = "builtin:terrain";
    std::vector<std::string> rays{"primary", "ao", "diffuse", "random"};
    std::string kind = "auto";
    std::string intersector = "opaque";
    std::string traversal = "auto";
    std::string precision = "fast";
    std::string target = "auto";
    std::string peers;
    std::vector<std::filesystem::path> pack_dirs;
    std::uint32_t count = 262144;
    unsigned threads = 1;
    int rounds = 7;
    bool json = false;
};

double thread_seconds() {
    timespec now{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

void flush_denormals() {
    _mm_setcsr(_mm_getcsr() | 0x8040U);  // FTZ and DAZ
}

double median(std::vector<double> values) {
    std::sort(values.begin(), values.end());
    return values[values.size() / 2];
}

// CPU seconds per thread of work(thread) on `threads` threads.
template <class Work>
double timed(unsigned threads, Work&& work) {
    std::vector<double> seconds(threads);
    std::vector<std::jthread> pool;
    for (unsigned i = 0; i < threads; ++i) {
        pool.emplace_back([&, i] {
            flush_denormals();
            const double start = thread_seconds();
            work(i);
            seconds[i] = thread_seconds() - start;
        });
    }
    pool.clear();
    double total = 0;
    for (const double s : seconds) total += s;
    return total / threads;
}

struct Row {
    double mrays = 0, peer_mrays = 0, ratio = 0;
    std::uint64_t mismatches = 0;
    std::string peer;
};

Row measure(const Options& options, const Workload& workload, const std::vector<Ray>& rays,
            Query query, TraceFunction function, Peer* peer) {
    const auto n = static_cast<std::uint32_t>(rays.size());
    std::vector<HitRecord> hits(n);
    std::vector<float> theirs(n);
    const std::uint32_t chunk = (n + options.threads - 1) / options.threads;
    const auto ours = [&](unsigned thread) {
        const std::uint32_t first = std::min(n, thread * chunk);
        const std::uint32_t count = std::min(chunk, n - first);
        const TraceCall call{&workload.scene->view(),
                             nullptr,
                             rays.data() + first,
                             count,
                             1,
                             0xFFFFFFFFU,
                             0,
                             hits.data() + first,
                             nullptr,
                             nullptr,
                             nullptr};
        function(&call);
    };
    const auto peers = [&](unsigned thread) {
        const std::uint32_t first = std::min(n, thread * chunk);
        const std::uint32_t count = std::min(chunk, n - first);
        const std::span<const Ray> part(rays.data() + first, count);
        const std::span<float> t(theirs.data() + first, count);
        query == query_any ? peer->any(part, t) : peer->closest(part, t);
    };

    Row row;
    std::vector<double> our_times;
    std::vector<double> their_times;
    std::vector<double> ratios;
    for (int round = -1; round < options.rounds; ++round) {  // round -1 warms caches and pages
        const double our_time = timed(options.threads, ours);
        const double their_time = peer != nullptr ? timed(options.threads, peers) : 0;
        if (round < 0) {
            for (std::uint32_t i = 0; peer != nullptr && i < n; ++i) {
                const bool hit = std::isfinite(theirs[i]);
                const bool close = query == query_any || !hit ||
                                   std::abs(hits[i].t - theirs[i]) <= 1e-4F * (1 + theirs[i]);
                if ((hits[i].hit != 0) != hit || !close) ++row.mismatches;
            }
            continue;
        }
        our_times.push_back(our_time);
        if (peer != nullptr) {
            their_times.push_back(their_time);
            ratios.push_back(their_time / our_time);
        }
    }
    const double millions = 1e-6 * n / options.threads;
    row.mrays = millions / median(our_times);
    if (peer != nullptr) {
        row.peer = peer->name();
        row.peer_mrays = millions / median(their_times);
        row.ratio = median(ratios);
    }
    return row;
}

int report(const Error& error) {
    std::cerr << "raynest-bench: " << error.message << "\n";
    return 5;
}

int run(const Options& options) {
    const auto registry = Registry::load({options.pack_dirs, options.target});
    if (!registry) return report(registry.error());
    const auto workload = load_workload(options.scene, **registry);
    if (!workload) return report(workload.error());
    const auto variant = (*registry)->choose(options.intersector, workload->scene->view());
    if (!variant) return report(variant.error());
    const auto traversal = parse_traversal(options.traversal);
    if (!traversal) return report(traversal.error());
    const auto precision = parse_precision(options.precision);
    if (!precision) return report(precision.error());
    const auto finder =
        find_function(**variant, query_closest, precision_fast, traversal_latency, false);
    if (!finder) return report(finder.error());

    std::unique_ptr<Peer> peer;
    if (options.peers == "embree") {
        auto made = make_embree(workload->description);
        if (!made) return report(made.error());
        peer = std::move(*made);
    }
    if (!options.json) {
        std::printf("%-12s %-8s %-8s %-9s %-6s %10s %10s %7s %10s\n", "scene", "rays", "kind",
                    "traversal", "target", "Mrays/s", "peer", "ratio", "mismatches");
    }
    for (const std::string& name : options.rays) {
        std::vector<Ray> rays;
        if (name.ends_with(".rays")) {
            auto loaded = load_rays(name);
            if (!loaded) return report(loaded.error());
            rays = std::move(*loaded);
        } else {
            const auto kind = parse_ray_kind(name);
            if (!kind) return report(kind.error());
            rays = make_rays(*workload, *kind, options.count, *finder);
        }
        if (rays.empty()) return report({ErrorCode::param_invalid, "no rays of kind " + name});
        const auto query = options.kind != "auto" ? parse_query(options.kind)
                           : name == "ao"         ? Result<Query>(query_any)
                                                  : Result<Query>(query_closest);
        if (!query) return report(query.error());
        const auto function = find_function(**variant, *query, *precision, *traversal, false);
        if (!function) return report(function.error());
        const Row row = measure(options, *workload, rays, *query, *function, peer.get());
        const char* kind = *query == query_any ? "any" : "closest";
        if (options.json) {
            const nlohmann::json line{{"scene", workload->name},
                                      {"rays", name},
                                      {"kind", kind},
                                      {"traversal", options.traversal},
                                      {"intersector", (*variant)->name},
                                      {"precision", options.precision},
                                      {"target", (*variant)->target},
                                      {"threads", options.threads},
                                      {"mrays", row.mrays},
                                      {"peer", row.peer},
                                      {"peer_mrays", row.peer_mrays},
                                      {"ratio", row.ratio},
                                      {"mismatches", row.mismatches}};
            std::cout << line.dump() << std::endl;
        } else {
            std::printf("%-12s %-8s %-8s %-9s %-6s %10.2f %10.2f %7.2f %10llu\n",
                        workload->name.c_str(), name.c_str(), kind, options.traversal.c_str(),
                        (*variant)->target.c_str(), row.mrays, row.peer_mrays, row.ratio,
                        static_cast<unsigned long long>(row.mismatches));
            std::fflush(stdout);
        }
    }
    return 0;
}

}  // namespace
}  // namespace raynest::bench

int main(int argc, char** argv) {
    raynest::bench::Options options;
    CLI::App app{
        "Rays per second of a variant, and ratios to a peer in the same process.\n"
        "Example: raynest-bench --scene builtin:forest --rays primary,ao --peers embree"};
    app.add_option("--scene,--soup", options.scene, "builtin:..., a .glb or a .soup");
    app.add_option("--rays", options.rays, "primary, ao, diffuse, random or a .rays file")
        ->delimiter(',');
    app.add_option("--kind", options.kind, "closest or any; default: any for ao, else closest");
    app.add_option("--intersector", options.intersector, "");
    app.add_option("--traversal", options.traversal, "auto, latency, batch, coherent");
    app.add_option("--precision", options.precision, "fast, watertight");
    app.add_option("--target", options.target, "auto, v2, v3, v4");
    app.add_option("--pack-dir", options.pack_dirs, "more kernel packs");
    app.add_option("--count", options.count, "rays per set")->check(CLI::Range(4096U, 1U << 26));
    app.add_option("--threads", options.threads, "")->check(CLI::Range(1U, 256U));
    app.add_option("--rounds", options.rounds, "")->check(CLI::Range(1, 1000));
    app.add_option("--peers", options.peers, "embree")->check(CLI::IsMember({"embree"}));
    app.add_flag("--json", options.json, "one JSON object per row");
    CLI11_PARSE(app, argc, argv);
    if (options.kind == "multi") {
        std::cerr << "raynest-bench: --kind multi needs a list per ray: use closest or any\n";
        return 2;
    }
    return raynest::bench::run(options);
}
