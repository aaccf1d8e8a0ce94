// Compares every intersector x query x target x depth with the brute-force reference of the same
// pack. A pack without one, such as a GPU's, is compared with the reference of an earlier target.
//
// Nothing is listed here: the matrix is what the registry loads, so intersectors in a pack outside
// this tree are tested too (--pack-dir). Answers must agree in every byte. promises.h checks the
// reference itself.
//
//   conformance [--against v3] [--target v2|v3|v4|cuda]... [--pack-dir DIR]... [--intersector NAME]
//               [--edge-rays N] [--rays N] [--outputs 1]
//
// --outputs 1: compares outputs, too, of an intersector that overrides no boxes (one that does sees
// fewer candidates with a tree). --against: this target also answers, with its reference only.
// --rays: rays of each kind and scene (1500).
//
//   conformance --kernels all        prints how many kernels each pack holds, and nothing else
//
// Prints one line per (target, intersector) and a closing line. Exits 1 on any difference, if a
// kernel has nothing to be compared with, or if a target named with --target has no kernel; 77 if
// such a target does not run here.
#include "engine/cuda/limits.h"
#include "engine/packs/registry.h"
#include "engine/scene/snapshot.h"
#include "tests/conformance/answers.h"
#include "tests/conformance/bad_input.h"
#include "tests/conformance/promises.h"
#include "tests/conformance/scenes.h"
#include "tests/sanitized.h"

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <exception>
#include <iomanip>
#include <iostream>
#include <iterator>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace raynest::conformance {
namespace {

struct Case {
    std::string name;
    std::uint32_t depth;
    std::shared_ptr<const Snapshot> scene;
    std::vector<Ray> rays;
    std::shared_ptr<const Snapshot> uncut = nullptr;  ///< the same scene, no triangle of it cut
};

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
        const HitRecord h = from->counts[ray] == 0 ? HitRecord{} : from->of(ray).front();
        std::cout << "  " << name << " hit " << int{h.hit} << " t " << h.t << " uv " << h.u << ' '
                  << h.v << " triangle " << h.triangle << " path " << h.path << " k " << int{h.k}
                  << " (of " << from->counts[ray] << ")" << std::endl;
    }
}

/// Places the scene's first object three times, turned and moved.
SceneDescription placed(SceneDescription scene, Random& random) {
    ObjectDescription root;
    root.name = "root";
    for (int i = 0; i < 3; ++i) {
        InstanceDescription one;
        one.object = 0;
        const Vec3 at = random.in_box(2);
        one.transform = Transform{{0, 1, 0, at.x, 0, 0, 1, at.y, 1, 0, 0, at.z}};
        root.instances.push_back(one);
    }
    scene.objects.push_back(std::move(root));
    scene.root = 1;
    return scene;
}

std::vector<Case> make_cases(std::uint32_t edge_ray_count, std::uint32_t ray_count) {
    std::vector<Case> cases;
    Random random(7);
    const auto built = [](const std::string& name, const SceneDescription& scene) {
        auto snapshot = Snapshot::build(scene);
        if (!snapshot) {
            throw std::runtime_error("scene " + name + ": " + snapshot.error().message);
        }
        return *snapshot;
    };
    const auto add = [&](std::string name, std::uint32_t depth, const SceneDescription& scene,
                         float half) {
        const std::uint32_t rays_each = test::sanitized_share(ray_count, 10U);
        Case test{name, depth, built(name, scene), {}};
        const auto append = [&](const std::vector<Ray>& more) {
            test.rays.insert(test.rays.end(), more.begin(), more.end());
        };
        if (!scene.objects[scene.root].geometries.empty()) {
            append(pinhole_rays(scene, rays_each, random));  // first, so that packets stay whole
            append(edge_rays(scene, rays_each, half, random));
        }
        append(random_rays(rays_each, half, random));
        append(odd_rays(rays_each / 2, half, random));
        cases.push_back(std::move(test));
    };
    for (const std::uint32_t depth : {1U, 2U, 3U, 4U, 8U}) {
        add("nested-" + std::to_string(depth), depth, nested_scene(depth, 1), 8);
    }
    for (const auto quality : {BuildQuality::fast, BuildQuality::medium, BuildQuality::high})
        add("crowded-" + std::to_string(static_cast<int>(quality)), 2, crowded_scene(6, quality),
            8);
    add("spheres-1", 1, sphere_scene(5), 8);
    for (const std::uint32_t depth : {1U, 2U}) {
        SceneDescription scene = depth == 1 ? needles(400, 5) : placed(needles(150, 6), random);
        const std::string name = "cut-" + std::to_string(depth);
        scene.build = BuildQuality::high;
        add(name, depth, scene, 8);
        scene.build = BuildQuality::medium;
        cases.back().uncut = built(name, scene);
    }
    add("nested-32", 32, nested_scene(32, 1), 8);
    const std::uint32_t bad_ray_count = test::sanitized_share(std::min(512U, ray_count), 8U);
    for (BadInput& bad : bad_inputs(bad_ray_count, random)) {
        if (!bad.scene.objects[bad.scene.root].geometries.empty()) {
            const auto rays = pinhole_rays(bad.scene, bad_ray_count, random);
            bad.rays.insert(bad.rays.end(), rays.begin(), rays.end());
        }
        cases.push_back({bad.name, bad.depth, built(bad.name, bad.scene), std::move(bad.rays)});
    }

    // Many rays at edges only: the box rule must not cull one.
    for (const std::uint32_t depth : {1U, 3U}) {
        const SceneDescription sheet = sheet_scene(128, depth, 3);
        const std::string name = "edges-" + std::to_string(depth);
        const std::uint32_t count = depth == 1 ? edge_ray_count : edge_ray_count / 8;
        cases.push_back({name, depth, built(name, sheet), pinhole_rays(sheet, count / 4, random)});
        const auto rays = edge_rays(sheet, count, 6, random);
        cases.back().rays.insert(cases.back().rays.end(), rays.begin(), rays.end());
    }
    return cases;
}

struct CheckCounts {
    std::uint64_t comparisons = 0, rays = 0, differences = 0, hits = 0, failures = 0, outputs = 0;
};

/// Checks one variant on all cases, one after the other.
class VariantCheck {
public:
    /// `golden` holds the answers of other targets' references, by question. With `reference_only`
    /// this variant's reference answers go there, and its other kernels are not tested.
    VariantCheck(const Variant& variant, std::map<std::string, Answer>& golden, bool reference_only,
                 bool with_outputs)
        : variant_(variant),
          golden_(golden),
          reference_only_(reference_only),
          with_outputs_(with_outputs) {}

    void check(const Case& test, const Settings& settings) {
        if (variant_.target == "cuda" && test.depth > cuda::levels_max) {
            check_refusal(test, settings);
            return;
        }
        const bool edges_only = test.name.starts_with("edges");
        std::vector<Answer> references;
        for (const Question& question : questions) {
            if (edges_only && question.query != query_closest) continue;
            const auto reference = find_function(variant_, question.query, traversal_reference);
            if (!reference) {
                check_without_reference(test, question, settings);
                continue;
            }
            const Snapshot& asked = test.uncut != nullptr ? *test.uncut : *test.scene;
            const Answer expected =
                ask(variant_, *reference, asked.view(), test.rays, question, settings);
            check_targets(test, question, settings, expected);
            if (reference_only_) continue;
            check_traversals(test, question, settings, expected);
            check_promises(test, question, expected);
            references.push_back(expected);
        }
        if (references.size() == std::size(questions)) check_agreement(test, references);
    }

    [[nodiscard]] const CheckCounts& counts() const { return counts_; }

private:
    // A GPU's kernels must refuse a scene that is nested too deep for them.
    void check_refusal(const Case& test, const Settings& settings) {
        const auto function = find_function(variant_, query_closest, traversal_single);
        if (!function) return;
        std::vector<HitRecord> hits(test.rays.size());
        TraceCall call{};
        call.scene = &test.scene->view();
        settings.apply_to(call);
        call.rays = test.rays.data();
        call.ray_count = static_cast<std::uint32_t>(test.rays.size());
        call.hits_max = 1;
        call.hits = hits.data();
        if ((*function)(&call) == trace_too_deep) return;
        std::printf("FAILED: %s does not refuse %s\n", variant_.name.c_str(), test.name.c_str());
        ++counts_.failures;
    }

    void check_traversals(const Case& test, const Question& question, const Settings& settings,
                          const Answer& expected) {
        if (test.uncut != nullptr)
            check_traversal(test, question, settings, traversal_reference, counters_none, expected);
        for (std::uint32_t t = 0; t < traversal_reference; ++t) {
            for (const CounterMode counters : {counters_none, counters_total, counters_by_level}) {
                if (test.name.starts_with("edges") && counters != counters_none) continue;
                check_traversal(test, question, settings, static_cast<Traversal>(t), counters,
                                expected);
            }
        }
    }

    void check_without_reference(const Case& test, const Question& question,
                                 const Settings& settings) {
        const auto others = golden_.find(key_of(test, question, settings));
        if (others != golden_.end()) {
            check_traversals(test, question, settings, others->second);
            return;
        }
        for (std::uint32_t t = 0; t < traversal_reference; ++t) {
            const auto traversal = static_cast<Traversal>(t);
            if (!find_function(variant_, question.query, traversal)) continue;
            ++counts_.failures;
            if (printed_++ >= 2) continue;
            std::printf("FAILED: %s %s %s query %u: no reference to compare it with\n",
                        variant_.target.c_str(), variant_.name.c_str(), test.name.c_str(),
                        question.query);
        }
    }

    [[nodiscard]] std::string key_of(const Case& test, const Question& question,
                                     const Settings& settings) const {
        return variant_.name + "/" + test.name + "/" + std::to_string(question.query) + "/" +
               std::to_string(question.hits_max) + "/" + std::to_string(settings.flags) +
               (settings.tables != nullptr ? "/tables" : "");
    }

    void check_traversal(const Case& test, const Question& question, const Settings& settings,
                         Traversal traversal, CounterMode counters, const Answer& expected) {
        const auto function = find_function(variant_, question.query, traversal, counters);
        if (!function) return;
        const Answer answer =
            ask(variant_, *function, test.scene->view(), test.rays, question, settings, counters);
        for (const HitRecord& hit : answer.hits) counts_.hits += hit.hit;
        const Difference different = compare(test, answer, expected);
        if (different.rays != 0 && printed_++ < 2) {
            std::printf(
                "FAILED: %s %s %s query %u traversal %u counters %u cull %u: "
                "%llu rays differ; the first:\n",
                variant_.target.c_str(), variant_.name.c_str(), test.name.c_str(), question.query,
                traversal, counters, settings.flags,
                static_cast<unsigned long long>(different.rays));
            print_ray(test, answer, expected, different.first);
        }
        if (with_outputs_) check_outputs(test, question, traversal, answer, expected);
        if (counters != counters_none && question.query == query_closest && settings.flags == 0) {
            check_counters(test, answer);
        }
        if (counters == counters_total) totals_ = answer.counters;
        if (counters == counters_by_level && !same_counters(answer.counters, totals_)) {
            std::printf("FAILED: %s %s: the levels do not add up to the total\n",
                        variant_.name.c_str(), test.name.c_str());
            ++counts_.failures;
        }
    }

    void check_outputs(const Case& test, const Question& question, Traversal traversal,
                       const Answer& answer, const Answer& expected) {
        if (const auto compared = compare_outputs(answer, expected, question)) {
            counts_.outputs += *compared;
            return;
        }
        ++counts_.failures;
        if (printed_++ >= 2) return;
        std::printf("FAILED: %s %s %s query %u traversal %u: outputs differ\n",
                    variant_.target.c_str(), variant_.name.c_str(), test.name.c_str(),
                    question.query, traversal);
    }

    // v3 and v4 agree bit for bit; v2 rounds differently and has its own reference.
    void check_targets(const Case& test, const Question& question, const Settings& settings,
                       const Answer& expected) {
        if (variant_.target == "v2") return;
        const std::string key = key_of(test, question, settings);
        const auto [at, fresh] = golden_.try_emplace(key, expected);
        if (fresh) return;
        const Difference different = compare(test, at->second, expected);
        if (different.rays == 0) return;
        std::printf("FAILED: %s differs between targets on %llu rays\n", key.c_str(),
                    static_cast<unsigned long long>(different.rays));
    }

    Difference compare(const Case& test, const Answer& answer, const Answer& expected) {
        const Difference different = differing_rays(answer, expected);
        ++counts_.comparisons;
        counts_.rays += test.rays.size();
        counts_.differences += different.rays;
        return different;
    }

    void check_promises(const Case& test, const Question& question, const Answer& answer) {
        for (std::size_t i = 0; i < test.rays.size(); ++i) {
            fail(test, answer, i, broken_promise(test.rays[i], i, question, answer));
        }
    }

    void check_agreement(const Case& test, const std::vector<Answer>& answers) {
        for (std::size_t i = 0; i < test.rays.size(); ++i) {
            fail(test, answers.back(), i, contradiction(answers, i));
        }
    }

    void fail(const Case& test, const Answer& answer, std::size_t ray, const char* why) {
        if (why == nullptr) return;
        ++counts_.failures;
        if (printed_++ >= 2) return;
        std::printf("FAILED: %s %s %s: %s\n", variant_.target.c_str(), variant_.name.c_str(),
                    test.name.c_str(), why);
        print_ray(test, answer, answer, ray);
    }

    static bool same_counters(const std::vector<Counters>& a, const std::vector<Counters>& b) {
        return a.size() == b.size() &&
               std::memcmp(a.data(), b.data(), a.size() * sizeof(Counters)) == 0;
    }

    // Counters show whether the hooks ran: every level below the first adds an instance entry, and
    // a ray that hits something visited a node or leaf and tested a primitive there.
    void check_counters(const Case& test, const Answer& answer) {
        std::uint32_t deepest = 0;
        for (std::size_t i = 0; i < test.rays.size(); ++i) {
            const Counters& c = answer.counters[i];
            deepest = std::max(deepest, c.instances);
            const bool hit = answer.hits[i].hit != 0;
            if (hit && (c.prims == 0 || c.leaves == 0)) ++counts_.failures;
            if (c.leaves > c.prims || c.nodes > c.boxes) ++counts_.failures;
        }
        if (deepest + 1 < test.depth) {
            std::printf("FAILED: %s on %s: the instance hook ran at most %u times, depth is %u\n",
                        variant_.name.c_str(), test.name.c_str(), deepest, test.depth);
            ++counts_.failures;
        }
    }

    const Variant& variant_;
    std::map<std::string, Answer>& golden_;
    const bool reference_only_;
    const bool with_outputs_;
    CheckCounts counts_;
    std::vector<Counters> totals_;  ///< for the question asked last
    int printed_ = 0;
};

/// Whole numbers from 0 on, as far as its range goes, for each parameter that is a table.
std::vector<NamedTable> some_tables(const Variant& variant) {
    std::vector<NamedTable> tables;
    for (const PackParam& param : variant.params()) {
        if (param.type != value_table) continue;
        NamedTable& table = tables.emplace_back(NamedTable{param.name, {}});
        for (int i = 0; i < 24; ++i)
            table.values.push_back(static_cast<float>(
                std::clamp(static_cast<double>(i), param.minimum, param.maximum)));
    }
    return tables;
}

void check_variant(const Variant& variant, const std::vector<Case>& cases, bool with_edges,
                   bool reference_only, bool with_outputs, CheckCounts& total,
                   std::map<std::string, Answer>& golden) {
    VariantCheck checked(variant, golden, reference_only, with_outputs);
    const auto plain = parse_settings(variant, {});
    const std::vector<std::pair<std::string, std::string>> cull{{"cull", "back"}};
    const auto culled = parse_settings(variant, cull);
    const std::vector<NamedTable> tables = some_tables(variant);
    const auto tabled = parse_settings(variant, {}, tables);
    for (const Case& test : cases) {
        const bool edges_only = test.name.starts_with("edges");
        if (edges_only && !with_edges) continue;
        checked.check(test, *plain);
        if (edges_only) continue;
        checked.check(test, *culled);
        if (!tables.empty()) checked.check(test, *tabled);
    }
    if (reference_only) return;
    const CheckCounts& counts = checked.counts();
    std::printf("%-4s %-18s %4llu comparisons %10llu rays %10llu hits %llu differences\n",
                variant.target.c_str(), variant.name.c_str(),
                static_cast<unsigned long long>(counts.comparisons),
                static_cast<unsigned long long>(counts.rays),
                static_cast<unsigned long long>(counts.hits),
                static_cast<unsigned long long>(counts.differences));
    total.comparisons += counts.comparisons;
    total.rays += counts.rays;
    total.differences += counts.differences;
    total.hits += counts.hits;
    total.failures += counts.failures;
    total.outputs += counts.outputs;
}

int main_checked(int argc, char** argv) {
    std::vector<std::string> targets;
    Registry::Options options;
    std::string only, against;
    bool with_outputs = false;
    std::uint32_t ray_count = 1500;
    std::uint32_t edge_ray_count = test::sanitized_share(test::usual_share(1'000'000U, 4U), 25U);
    for (int i = 1; i + 1 < argc; i += 2) {
        const std::string flag = argv[i];
        if (flag == "--target") targets.emplace_back(argv[i + 1]);
        if (flag == "--pack-dir") options.pack_dirs.emplace_back(argv[i + 1]);
        if (flag == "--intersector") only = argv[i + 1];
        if (flag == "--against") against = argv[i + 1];
        if (flag == "--outputs") with_outputs = std::string(argv[i + 1]) != "0";
        if (flag == "--rays") ray_count = static_cast<std::uint32_t>(std::stoul(argv[i + 1]));
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
    if (!against.empty()) {
        targets.push_back(against);
        std::rotate(targets.begin(), targets.end() - 1, targets.end());
    }
    const bool named = !targets.empty();
    if (!named) targets = {"v2", "v3", "v4"};
    std::vector<std::shared_ptr<const Registry>> registries;
    for (const std::string& target : targets) {
        options.target = target;
        const auto registry = Registry::load(options);
        if (registry) {
            registries.push_back(*registry);
            continue;
        }
        std::printf("skipped: target %s: %s\n", target.c_str(), registry.error().message.c_str());
        if (named) return 77;
    }
    const std::vector<Case> cases = make_cases(edge_ray_count, ray_count);
    CheckCounts total;
    std::map<std::string, Answer> golden;
    for (const auto& registry : registries) {
        const bool reference_only = registry->packs().front()->target == against;
        const std::uint64_t compared = total.comparisons;
        bool with_edges = true;  // only for one variant: all share the box rule
        for (const Variant& variant : registry->variants()) {
            if (!only.empty() && variant.name != only) continue;
            check_variant(variant, cases, with_edges, reference_only, with_outputs, total, golden);
            with_edges = false;
        }
        if (with_outputs && total.outputs == 0) {
            std::printf("FAILED: no output was compared\n");
            ++total.failures;
        }
        if (named && !reference_only && total.comparisons == compared) {
            std::printf("FAILED: target %s: nothing was compared\n",
                        registry->packs().front()->target);
            ++total.failures;
        }
    }
    std::printf(
        "conformance: %llu comparisons, %llu rays, %llu hits, %llu differing rays, "
        "%llu failures\n",
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
    try {
        return raynest::conformance::main_checked(argc, argv);
    } catch (const std::exception& problem) {
        std::printf("FAILED: %s\n", problem.what());
        return 1;
    }
}
