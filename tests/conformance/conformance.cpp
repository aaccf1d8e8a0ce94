// Every intersector x query x target x depth against the brute-force reference of the same pack.
//
// Nothing is listed here: the matrix is what the registry loads, so an intersector in a pack
// outside this tree goes through it too (--pack-dir). A difference is a difference of bytes.
//
//   conformance [--target v2|v3|v4] [--pack-dir DIR]... [--intersector NAME] [--edge-rays N]
//   conformance --kernels all        how many kernels each pack holds, and nothing else
//
// Prints one line per (target, intersector) and a closing line; exits 1 on any difference.
#include "engine/packs/registry.h"
#include "engine/scene/snapshot.h"
#include "tests/conformance/scenes.h"
#include "tests/sanitized.h"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <iomanip>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

namespace raynest::conformance {
namespace {

struct Answer {
    std::vector<HitRecord> hits;
    std::vector<std::size_t> first;  // of each ray's hits
    std::vector<std::uint32_t> counts;
    std::vector<std::uint8_t> ray_flags;  // of `all`
    std::vector<Counters> counters;
    std::vector<std::vector<std::uint32_t>> outputs;
};

struct Case {
    std::string name;
    std::uint32_t depth;
    std::shared_ptr<const Snapshot> scene;
    std::vector<Ray> rays;
};

/// What is asked of every ray. The small budget of `all` cuts many rays short, the large one none.
struct Question {
    Query query;
    std::uint32_t hits_max;
};
constexpr Question questions[] = {
    {query_closest, 1}, {query_any, 1}, {query_multi, 8}, {query_all, 3}, {query_all, 4096}};

void check_call(TraceStatus status, const Variant& variant) {
    if (status == trace_ok) return;
    std::printf("FAILED: %s refused a well-formed call\n", variant.name.c_str());
    std::exit(1);
}

// All hits, through as little room as there may be, so that calls end within the rays and go on.
Answer run_all(const Variant& variant, TraceFunction function, TraceCall call) {
    const std::uint32_t n = call.ray_count;
    Answer answer;
    answer.counts.resize(n);
    answer.ray_flags.resize(n);
    std::vector<HitRecord> room(std::size_t{2} * call.hits_max);
    call.hits = room.data();
    call.hits_room = room.size();
    std::uint32_t fresh = 0;
    call.rays_done = &fresh;
    for (std::uint32_t done = 0; done < n; done += fresh) {
        call.ray_count = n - done;
        call.hit_counts = answer.counts.data() + done;
        call.ray_flags = answer.ray_flags.data() + done;
        check_call(function(&call), variant);
        if (fresh == 0) {
            std::printf("FAILED: %s finds no room for ray %u\n", variant.name.c_str(), done);
            std::exit(1);
        }
        std::size_t end = 0;
        for (std::uint32_t i = done; i < done + fresh; ++i) {
            answer.first.push_back(answer.hits.size() + end);
            end += answer.counts[i];
        }
        answer.hits.insert(answer.hits.end(), room.begin(),
                           room.begin() + static_cast<std::ptrdiff_t>(end));
        call.rays += fresh;
    }
    return answer;
}

Answer run(const Variant& variant, const Case& test, TraceFunction function,
           const Question& question, const Settings& settings) {
    const auto n = static_cast<std::uint32_t>(test.rays.size());
    const std::uint32_t capacity = question.query == query_all ? 0 : question.hits_max;
    Answer answer;
    answer.hits.resize(static_cast<std::size_t>(n) * capacity);
    for (std::uint32_t i = 0; i < n; ++i) answer.first.push_back(std::size_t{i} * capacity);
    answer.counts.assign(n, 1);
    answer.counters.resize(n);
    answer.outputs.assign(variant.outputs().size(), std::vector<std::uint32_t>(n));
    std::vector<void*> columns;
    for (auto& column : answer.outputs) columns.push_back(column.data());
    const TraceCall call{&test.scene->view(),  settings.params.data(),
                         test.rays.data(),     n,
                         question.hits_max,    0xFFFFFFFFU,
                         settings.flags,       answer.hits.data(),
                         answer.counts.data(), answer.counters.data(),
                         columns.data()};
    if (question.query == query_all) return run_all(variant, function, call);
    check_call(function(&call), variant);
    return answer;
}

struct Difference {
    std::uint64_t rays = 0;
    std::size_t first = 0;  // index of the first of them
};

// Rays whose answer differs. Only what a query defines is compared: of `multi` the filled part.
Difference differing_rays(const Answer& a, const Answer& b) {
    Difference different;
    const std::size_t n = a.counts.size();
    for (std::size_t i = 0; i < n; ++i) {
        bool same = a.counts[i] == b.counts[i];
        if (!a.ray_flags.empty()) same = same && a.ray_flags[i] == b.ray_flags[i];
        for (std::size_t k = 0; same && k < a.counts[i]; ++k) {
            same = std::memcmp(&a.hits[a.first[i] + k], &b.hits[b.first[i] + k],
                               sizeof(HitRecord)) == 0;
        }
        if (!same && different.rays++ == 0) different.first = i;
    }
    return different;
}

void print_ray(const Case& test, const Answer& answer, const Answer& expected, std::size_t ray) {
    const auto text = [](const Vec3& v) {
        std::ostringstream out;
        out << std::setprecision(9) << v.x << ' ' << v.y << ' ' << v.z;
        return out.str();
    };
    const Ray& r = test.rays[ray];
    std::cout << std::setprecision(9) << "  ray " << ray << ": origin " << text(r.origin)
              << " tmin " << r.tmin << " direction " << text(r.direction) << " tmax " << r.tmax
              << '\n';
    for (const auto& [name, from] : {std::pair{"got     ", &answer}, {"expected", &expected}}) {
        const HitRecord h = from->counts[ray] == 0 ? HitRecord{} : from->hits[from->first[ray]];
        std::cout << "  " << name << " hit " << int{h.hit} << " t " << h.t << " uv " << h.u << ' '
                  << h.v << " triangle " << h.triangle << " path " << h.path << " k " << int{h.k}
                  << " (of " << from->counts[ray] << ")" << std::endl;
    }
}

std::vector<Case> make_cases(std::uint32_t edge_ray_count) {
    std::vector<Case> cases;
    Random random(7);
    const auto add = [&](std::string name, std::uint32_t depth, const SceneDescription& scene,
                         std::uint32_t rays_whole, float half) {
        const std::uint32_t rays_each = test::sanitized_share(rays_whole, 10U);
        auto snapshot = Snapshot::bake(scene);
        if (!snapshot) {
            std::printf("FAILED: scene %s: %s\n", name.c_str(), snapshot.error().message.c_str());
            std::exit(1);
        }
        Case test{std::move(name), depth, *snapshot, {}};
        for (const auto& more : {random_rays(rays_each, half, random),
                                 scene.objects[scene.root].geometries.empty()
                                     ? std::vector<Ray>{}
                                     : edge_rays(scene, rays_each, half, random),
                                 odd_rays(rays_each / 2, half, random)}) {
            test.rays.insert(test.rays.end(), more.begin(), more.end());
        }
        cases.push_back(std::move(test));
    };
    for (const std::uint32_t depth : {1U, 2U, 3U, 4U}) {
        add("nested-" + std::to_string(depth), depth, nested_scene(depth, 1), 1500, 8);
    }
    add("spheres-1", 1, sphere_scene(5), 1500, 8);
    add("nested-32", 32, nested_scene(32, 1), 1500, 8);

    // Only edges, many: the box rule must not cull one.
    for (const std::uint32_t depth : {1U, 3U}) {
        const SceneDescription sheet = sheet_scene(128, depth, 3);
        auto snapshot = Snapshot::bake(sheet);
        if (!snapshot) std::exit(1);
        const std::uint32_t count = depth == 1 ? edge_ray_count : edge_ray_count / 8;
        cases.push_back({"edges-" + std::to_string(depth), depth, *snapshot,
                         edge_rays(sheet, count, 6, random)});
    }
    return cases;
}

struct Tally {
    std::uint64_t comparisons = 0, rays = 0, differences = 0, hits = 0, failures = 0;
};

// Counters say whether the hooks ran: every level below the first adds an instance entry, and a ray
// that hits something visited a node or leaf and tested a primitive there.
void check_counters(const Case& test, const Answer& answer, const Variant& variant, Tally& tally) {
    std::uint32_t deepest = 0;
    for (std::size_t i = 0; i < test.rays.size(); ++i) {
        const Counters& c = answer.counters[i];
        deepest = std::max(deepest, c.instances);
        const bool hit = answer.hits[i].hit != 0;
        if (hit && (c.prims == 0 || c.leaves == 0)) ++tally.failures;
        if (c.leaves > c.prims || c.nodes > c.boxes) ++tally.failures;
    }
    if (deepest + 1 < test.depth) {
        std::printf("FAILED: %s on %s: the instance hook ran at most %u times, depth is %u\n",
                    variant.name.c_str(), test.name.c_str(), deepest, test.depth);
        ++tally.failures;
    }
}

void check_variant(const Variant& variant, const std::vector<Case>& cases, bool with_edges,
                   Tally& total, std::map<std::string, Answer>& golden) {
    Tally tally;
    int printed = 0;
    const auto plain = parse_settings(variant, {});
    const std::vector<std::pair<std::string, std::string>> cull{{"cull", "back"}};
    const auto culled = parse_settings(variant, cull);
    for (const Case& test : cases) {
        if (test.name.starts_with("edges") && !with_edges) continue;
        for (const Question& question : questions) {
            const Query query = question.query;
            for (const Settings* settings : {&*plain, &*culled}) {
                const bool edges_only = test.name.starts_with("edges");
                if (edges_only && (query != query_closest || settings == &*culled)) continue;
                const auto reference =
                    find_function(variant, query, precision_fast, traversal_reference, false);
                const Answer expected = run(variant, test, *reference, question, *settings);
                for (std::uint32_t t = 0; t < traversal_reference; ++t) {
                    for (const bool counting : {false, true}) {
                        const auto function = find_function(variant, query, precision_fast,
                                                            static_cast<Traversal>(t), counting);
                        if (!function || (edges_only && counting)) continue;
                        const Answer answer = run(variant, test, *function, question, *settings);
                        const Difference different = differing_rays(answer, expected);
                        ++tally.comparisons;
                        tally.rays += test.rays.size();
                        tally.differences += different.rays;
                        for (const HitRecord& hit : answer.hits) tally.hits += hit.hit;
                        if (different.rays != 0 && printed++ < 2) {
                            std::printf(
                                "FAILED: %s %s %s query %u traversal %u counting %d cull %u: "
                                "%llu rays differ; the first:\n",
                                variant.target.c_str(), variant.name.c_str(), test.name.c_str(),
                                query, t, counting, settings->flags,
                                static_cast<unsigned long long>(different.rays));
                            print_ray(test, answer, expected, different.first);
                        }
                        if (counting && query == query_closest && settings == &*plain) {
                            check_counters(test, answer, variant, tally);
                        }
                    }
                }
                // v3 and v4 agree bit for bit; v2 rounds differently and is its own reference.
                if (variant.target == "v2") continue;
                const std::string key =
                    variant.name + "/" + test.name + "/" + std::to_string(query) + "/" +
                    std::to_string(question.hits_max) + "/" + std::to_string(settings->flags);
                const auto [at, fresh] = golden.try_emplace(key, expected);
                if (!fresh) {
                    const Difference different = differing_rays(at->second, expected);
                    ++tally.comparisons;
                    tally.rays += test.rays.size();
                    tally.differences += different.rays;
                    if (different.rays != 0) {
                        std::printf("FAILED: %s differs between targets on %llu rays\n",
                                    key.c_str(), static_cast<unsigned long long>(different.rays));
                    }
                }
            }
        }
    }
    std::printf("%-4s %-18s %4llu comparisons %10llu rays %10llu hits %llu differences\n",
                variant.target.c_str(), variant.name.c_str(),
                static_cast<unsigned long long>(tally.comparisons),
                static_cast<unsigned long long>(tally.rays),
                static_cast<unsigned long long>(tally.hits),
                static_cast<unsigned long long>(tally.differences));
    total.comparisons += tally.comparisons;
    total.rays += tally.rays;
    total.differences += tally.differences;
    total.hits += tally.hits;
    total.failures += tally.failures;
}

int main_checked(int argc, char** argv) {
    std::vector<std::string> targets{"v2", "v3", "v4"};
    Registry::Options options;
    std::string only;
    std::uint32_t edge_ray_count = test::sanitized_share(1'000'000U, 100U);
    for (int i = 1; i + 1 < argc; i += 2) {
        const std::string flag = argv[i];
        if (flag == "--target") targets = {argv[i + 1]};
        if (flag == "--pack-dir") options.pack_dirs.emplace_back(argv[i + 1]);
        if (flag == "--intersector") only = argv[i + 1];
        if (flag == "--edge-rays")
            edge_ray_count = static_cast<std::uint32_t>(std::stoul(argv[i + 1]));
    }
    if (argc > 1 && std::string(argv[1]) == "--kernels") {
        const auto registry = Registry::load(options);
        if (!registry) return 1;
        for (const Pack* pack : (*registry)->packs()) {
            std::printf("%s %u kernels\n", pack->target, pack->kernel_count);
        }
        return 0;
    }
    const std::vector<Case> cases = make_cases(edge_ray_count);
    Tally total;
    std::map<std::string, Answer> golden;
    for (const std::string& target : targets) {
        options.target = target;
        const auto registry = Registry::load(options);
        if (!registry) {
            std::printf("skipped: target %s: %s\n", target.c_str(),
                        registry.error().message.c_str());
            continue;
        }
        bool with_edges = true;  // the box rule is the same for all: the first variant is enough
        for (const Variant& variant : (*registry)->variants()) {
            if (!only.empty() && variant.name != only) continue;
            check_variant(variant, cases, with_edges, total, golden);
            with_edges = false;
        }
    }
    std::printf(
        "conformance: %llu comparisons, %llu rays, %llu hits, %llu differing rays, "
        "%llu hook failures\n",
        static_cast<unsigned long long>(total.comparisons),
        static_cast<unsigned long long>(total.rays), static_cast<unsigned long long>(total.hits),
        static_cast<unsigned long long>(total.differences),
        static_cast<unsigned long long>(total.failures));
    const bool tested = total.comparisons != 0 && total.hits != 0;
    return tested && total.differences == 0 && total.failures == 0 ? 0 : 1;
}

}  // namespace
}  // namespace raynest::conformance

int main(int argc, char** argv) {
    return raynest::conformance::main_checked(argc, argv);
}
