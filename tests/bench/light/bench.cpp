// raynest-bench-light: what a path-traced picture costs beside its rays.
//
//   raynest-bench-light --scene temple.glb           a row per CPU target
//
// Some tiles of a picture are made in this process, tile by tile, and after each tile its rays are
// traced once more by the bare stream traversal. All figures of a row are ratios of CPU seconds of
// the same laps. BENCH.md says what the rows mean; light.py adds what a daemon shows.
#include "engine/integrators/camera.h"
#include "engine/integrators/target_module.h"
#include "engine/packs/kernel_selector.h"
#include "tests/bench/clock.h"
#include "tests/bench/cpus.h"
#include "tests/bench/race.h"
#include "tests/bench/workload.h"

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstring>
#include <iostream>
#include <map>

namespace raynest::bench {
namespace {

struct Options {
    std::string scene = "builtin:forest";
    std::string camera;
    std::string intersector = "auto";
    std::string integrator = "path";
    std::vector<std::string> targets;  ///< empty: all that run here, and the baseline
    std::uint32_t width = 1920, height = 1080, samples = 32, tiles = 16;
    std::uint32_t depth = 8;
    int rounds = 7;
    bool shade_only = false;  ///< for a profiler: answers are remembered, nothing is traced
    bool json = false;
};

[[noreturn]] void give_up(const std::string& why) {
    std::cerr << "raynest-bench-light: " << why << "\n";
    std::exit(1);
}

template <class T, class E>
T must(tl::expected<T, E>&& result) {
    if (!result) give_up(result.error().message);
    return std::move(*result);
}

constexpr std::uint32_t call_rays = 16384;  // as a daemon's chunk
constexpr std::uint32_t tile_pixels = 512;  // 64 x 8, as a film's tile

/// The rays of one call of a caster, and what the call answered.
struct Call {
    Query query;
    std::vector<Ray> rays;
    std::vector<HitRecord> hits;
};

/// Traces as a worker does: in chunks, each by the traversal that suits its rays.
class TimedCaster final : public RayCaster {
public:
    TimedCaster(const SceneView& scene, const Variant& variant, Traversal traversal)
        : scene_(scene) {
        for (const Query query : {query_closest, query_any})
            selectors_.emplace(query, must(KernelSelector::make(variant, query, traversal)));
    }
    double seconds = 0;  ///< CPU time of all calls
    std::uint64_t rays = 0;
    std::vector<Call>* record = nullptr;        ///< calls are added to it
    const std::vector<Call>* replay = nullptr;  ///< calls are answered from it
    std::size_t replayed = 0;

    using RayCaster::closest;
    bool closest(std::span<const Ray> all, std::span<HitRecord> hits) override {
        if (replay != nullptr) {
            std::ranges::copy((*replay)[replayed++].hits, hits.begin());
            return true;
        }
        const double begin = seconds_of(CLOCK_THREAD_CPUTIME_ID);
        trace(query_closest, all, hits);
        seconds += seconds_of(CLOCK_THREAD_CPUTIME_ID) - begin;
        remember(query_closest, all, hits);
        return true;
    }
    bool occluded(std::span<const Ray> all, std::span<std::uint8_t> answers) override {
        if (replay != nullptr) {
            std::ranges::transform((*replay)[replayed++].hits, answers.begin(), &HitRecord::hit);
            return true;
        }
        const double begin = seconds_of(CLOCK_THREAD_CPUTIME_ID);
        if (any_hits_.size() < all.size()) any_hits_.resize(all.size());
        trace(query_any, all, any_hits_);
        std::ranges::transform(std::span(any_hits_).first(all.size()), answers.begin(),
                               &HitRecord::hit);
        seconds += seconds_of(CLOCK_THREAD_CPUTIME_ID) - begin;
        remember(query_any, all, any_hits_);
        return true;
    }
    bool counted(std::span<const Ray>, std::span<HitRecord>, std::span<Counters>) override {
        return false;
    }
    bool observed(std::span<const Ray>, std::span<HitRecord>, const Observer&) override {
        return false;
    }

    void trace(Query query, std::span<const Ray> all, std::span<HitRecord> hits) {
        const KernelSelector& selector = selectors_.at(query);
        for (std::size_t done = 0; done < all.size(); done += call_rays) {
            const auto part =
                all.subspan(done, std::min<std::size_t>(call_rays, all.size() - done));
            TraceCall call{};
            call.scene = &scene_;
            call.mask = ~0U;
            call.hits_max = 1;
            call.rays = part.data();
            call.ray_count = static_cast<std::uint32_t>(part.size());
            call.hits = hits.data() + done;
            if (selector.function(selector.choose(part, scene_))(&call) != trace_ok)
                give_up("a trace failed");
        }
        rays += all.size();
    }

private:
    void remember(Query query, std::span<const Ray> all, std::span<const HitRecord> hits) {
        if (record == nullptr) return;
        record->push_back({query,
                           {all.begin(), all.end()},
                           {hits.begin(), hits.begin() + static_cast<std::ptrdiff_t>(all.size())}});
    }
    const SceneView& scene_;
    std::map<Query, KernelSelector> selectors_;
    std::vector<HitRecord> any_hits_;
};

/// CPU seconds of one tile in one lap.
struct Cost {
    double all = 0, traced = 0, bare = 0;
};

/// One CPU target: its integrator and its kernels.
struct Side {
    std::string target;
    std::shared_ptr<const Registry> registry;
    std::unique_ptr<const Integrator> integrator;
    std::unique_ptr<TimedCaster> caster, bare;
    std::unique_ptr<Film> film;
    std::vector<std::vector<Call>> calls;  ///< by tile
    std::vector<std::vector<Cost>> laps;   ///< by tile
    std::uint64_t rays = 0;

    [[nodiscard]] double seconds(double Cost::*value) const {
        double sum = 0;
        for (const std::vector<Cost>& tile : laps) {
            std::vector<double> values;
            for (const Cost& lap : tile) values.push_back(lap.*value);
            sum += median(std::move(values));
        }
        return sum;
    }
};

class Contest {
public:
    explicit Contest(const Options& options)
        : options_(options),
          registry_(must(Registry::load({{}, "auto"}))),
          workload_(must(load_workload(options.scene, *registry_))),
          sensor_(camera_sensor(must(choose_camera(*workload_.scene, {.name = options.camera})), {},
                                {options.width, options.height})) {
        std::vector<std::string> targets = options.targets;
        if (targets.empty()) {
            targets.emplace_back("baseline");
            for (const std::string_view name : cpu_targets())
                if (Registry::load({{}, std::string(name)})) targets.emplace_back(name);
        }
        for (const std::string& target : targets) sides_.push_back(make_side(target));
    }

    void run() {
        for (Side& side : sides_) remember_calls(side);
        for (int round = 0; round < options_.rounds; ++round)
            for (std::uint32_t tile = 0; tile < options_.tiles; ++tile)
                for (std::size_t i = 0; i < sides_.size(); ++i) {
                    Side& side = sides_[(i + static_cast<std::size_t>(round)) % sides_.size()];
                    side.laps[tile].push_back(lap(side, tile));
                }
        for (const Side& side : sides_) print(side);
    }

private:
    Side make_side(const std::string& target) {
        Side side;
        side.target = target;
        const bool baseline = target == "baseline";
        side.registry = must(Registry::load({{}, baseline ? "auto" : target}));
        const SceneView& view = workload_.scene->view();
        IntegratorScene scene{{},
                              workload_.scene->bounds(),
                              &workload_.scene->shading(),
                              baseline ? "" : std::string_view(side.target)};
        scene.source.scene = &view;
        if (!baseline && must(integrator_code(target)) == nullptr)
            give_up("no integrators for target " + target + ": build raynest_packs");
        IntegratorSettings settings;
        settings.depth = options_.depth;
        side.integrator = must(make_integrator(options_.integrator, scene, settings));
        // A lit picture blends where no intersector is named, as at a daemon.
        const bool blends = options_.intersector == "auto" && view.masked_materials != 0;
        const Variant* variant =
            must(side.registry->choose(blends ? "alpha_blend" : options_.intersector, view));
        side.caster = std::make_unique<TimedCaster>(view, *variant, traversal_auto);
        const bool stream = variant->code->trace[traversal_stream][query_closest][0] != nullptr;
        side.bare = std::make_unique<TimedCaster>(view, *variant,
                                                  stream ? traversal_stream : traversal_single);
        side.film = std::make_unique<Film>(ImageSize{options_.width, options_.height});
        side.calls.resize(options_.tiles);
        side.laps.resize(options_.tiles);
        return side;
    }

    /// Tiles spread over the picture.
    [[nodiscard]] SampleRange range_of(std::uint32_t tile) const {
        const std::uint64_t all = std::uint64_t{options_.width} * options_.height / tile_pixels;
        const std::uint64_t place = (2 * tile + 1) * all / (2 * options_.tiles);
        return {sensor_, place * tile_pixels, tile_pixels, 0, options_.samples, 1};
    }

    void render(Side& side, std::uint32_t tile) {
        if (!add_samples(*side.integrator, range_of(tile), *side.caster, arrays_, *side.film))
            give_up("the integrator gave up");
    }

    void remember_calls(Side& side) {
        for (std::uint32_t tile = 0; tile < options_.tiles; ++tile) {
            side.caster->record = &side.calls[tile];
            render(side, tile);
        }
        side.caster->record = nullptr;
        side.rays = side.caster->rays;
    }

    Cost lap(Side& side, std::uint32_t tile) {
        side.caster->replay = options_.shade_only ? &side.calls[tile] : nullptr;
        side.caster->replayed = 0;
        const double traced = side.caster->seconds;
        const double begin = seconds_of(CLOCK_THREAD_CPUTIME_ID);
        render(side, tile);
        const double middle = seconds_of(CLOCK_THREAD_CPUTIME_ID);
        if (!options_.shade_only)
            for (const Call& call : side.calls[tile]) {
                if (hits_.size() < call.rays.size()) hits_.resize(call.rays.size());
                side.bare->trace(call.query, call.rays, hits_);
            }
        const double end = seconds_of(CLOCK_THREAD_CPUTIME_ID);
        return {middle - begin, side.caster->seconds - traced, end - middle};
    }

    void print(const Side& side) const {
        const double all = side.seconds(&Cost::all);
        const double traced = side.seconds(&Cost::traced);
        const double bare = side.seconds(&Cost::bare);
        const Side& first = sides_.front();
        bool same = true;
        for (std::size_t i = 0; i < film_layers; ++i) {
            const auto a = first.film->words(static_cast<FilmLayer>(i));
            const auto b = side.film->words(static_cast<FilmLayer>(i));
            same = same && std::memcmp(a.data(), b.data(), a.size_bytes()) == 0;
        }
        const auto rays = static_cast<double>(side.rays);
        const double shading = all - traced;
        const double before = first.seconds(&Cost::all) - first.seconds(&Cost::traced);
        const nlohmann::json row = {
            {"scene", workload_.name},
            {"target", side.target},
            {"rays", side.rays},
            {"share", shading / all},
            {"traversal_over_stream", traced > 0 ? bare / traced : 0},
            {"shading_ns", 1e9 * shading / rays},
            {"tracing_ns", 1e9 * traced / rays},
            {"shading_over_first", shading / before},
            {"same_bytes_as_first", same},
        };
        if (options_.json) {
            std::cout << row.dump() << "\n";
            return;
        }
        std::cout << row["scene"].get<std::string>() << " " << side.target << ": shading "
                  << 100 * shading / all << " % of the CPU, " << 1e9 * shading / rays
                  << " ns a ray (" << shading / before << " of the first row's), rays "
                  << 1e9 * traced / rays << " ns, " << (traced > 0 ? bare / traced : 0)
                  << " of the bare stream's rate" << (same ? "" : ", OTHER BYTES") << "\n";
    }

    const Options& options_;
    std::shared_ptr<const Registry> registry_;
    Workload workload_;
    Sensor sensor_;
    std::vector<Side> sides_;
    Wavefront arrays_;
    std::vector<HitRecord> hits_;
};

}  // namespace
}  // namespace raynest::bench

int main(int argc, char** argv) {
    using namespace raynest::bench;
    Options options;
    CLI::App app{
        "What a path-traced picture costs beside its rays.\n"
        "Example: raynest-bench-light --scene builtin:forest"};
    app.add_option("--scene", options.scene, "gen:..., builtin:... or a .glb");
    app.add_option("--camera", options.camera, "name or number");
    app.add_option("--intersector", options.intersector, "");
    app.add_option("--integrator", options.integrator, "");
    app.add_option("--target", options.targets, "baseline, v2, v3, v4")->delimiter(',');
    app.add_option("--width", options.width, "")->check(CLI::Range(64U, 16384U));
    app.add_option("--height", options.height, "")->check(CLI::Range(8U, 16384U));
    app.add_option("--spp", options.samples, "of a pixel")->check(CLI::Range(1U, 1024U));
    app.add_option("--tiles", options.tiles, "of 512 pixels, spread over the picture")
        ->check(CLI::Range(1U, 4096U));
    app.add_option("--depth", options.depth, "");
    app.add_option("--rounds", options.rounds, "")->check(CLI::Range(1, 10000));
    app.add_flag("--shade-only", options.shade_only,
                 "for a profiler: answer from memory instead of tracing");
    app.add_flag("--json", options.json, "one JSON object per row");
    CLI11_PARSE(app, argc, argv);
    pin(0);
    Contest(options).run();
    return 0;
}
