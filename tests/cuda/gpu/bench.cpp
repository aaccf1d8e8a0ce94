// raynest-bench-cuda: compares a GPU with the CPU on one scene and one file of rays, and times it.
//
//   raynest-bench-cuda check --pack CUDA.so --cpu-pack V3.so --arena F.arena --rays F.rays
//   raynest-bench-cuda time  --pack CUDA.so --arena F.arena --rays F.rays
//
// For a bare machine: it needs only the packs and a driver, and reads arenas that
// raynest-bench-arena wrote. Exit codes: 0; 1 something failed; 2 a wrong argument; 9 answers
// differ; 77 there is no GPU.
#include "engine/bvh/pages.h"
#include "engine/math/random.h"
#include "engine/scene/checks/arena_check.h"
#include "tests/bench/files.h"
#include "tests/bench/rays.h"
#include "tests/bench/value_of.h"
#include "tests/cuda/gpu/measure.h"
#include "tests/cuda/gpu/options.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <exception>
#include <filesystem>
#include <iostream>

namespace raynest::bench {
namespace {

constexpr int exit_failed = 1;
constexpr int exit_differs = 9;
constexpr int exit_no_device = 77;

/// Reads an arena into memory that is aligned as a view needs it.
Pages read_arena(const std::string& path) {
    const std::vector<std::byte> bytes = value_of(read_file(path));
    Pages arena(bytes.size());
    std::memcpy(arena.data(), bytes.data(), bytes.size());
    return arena;
}

/// Returns camera rays for a square picture of at least `count` pixels, with the whole scene in
/// view.
PinholeRays look_at(const Box& bounds, std::uint32_t count) {
    const auto side = static_cast<std::uint32_t>(std::ceil(std::sqrt(count)));
    const glm::dvec3 size(bounds.size());
    const double extent = std::max({size.x, size.y, size.z});
    Pinhole camera;
    camera.sensor_pose.pose.origin =
        glm::dvec3(0.5F * (bounds.lower + bounds.upper)) + glm::dvec3(0, 0, 1.5 * extent);
    camera.size = {side, side};
    camera.center_x = camera.center_y = side / 2.0;
    camera.step_x = camera.step_y = 1.0 / side;
    return {camera, 0, true};
}

std::vector<Ray> make_rays(const CudaOptions& options, const Box& bounds, const PinholeRays& made) {
    if (options.rays == "random") {
        Random random(17);
        return random_rays(bounds, options.count, random);
    }
    if (options.rays == "camera") {
        std::vector<Ray> rays(options.count);
        for (std::size_t i = 0; i < rays.size(); ++i) rays[i] = made.ray(i);
        return rays;
    }
    return value_of(read_rays(options.rays));
}

int run(const CudaOptions& options) {
    const Pages arena = read_arena(options.arena);
    const SceneView scene = value_of(check_arena({arena.data(), arena.size()}));
    const Box& bounds = scene.objects[scene.root].bounds;
    const PinholeRays made = look_at(bounds, options.count);
    const std::vector<Ray> rays = make_rays(options, bounds, made);
    if (rays.empty()) throw std::runtime_error(options.rays + ": no rays; pass --count");
    const OpenDevice device(options.pack);

    Work work{scene, rays, options.count, options.chunk, options.rays == "camera" ? &made : nullptr,
              {}};
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
    const auto parsed = parse_cuda_options(argc, argv);
    if (!parsed.options) return parsed.exit_code;
    try {
        return run(*parsed.options);
    } catch (const NoDevice& error) {
        std::cerr << "raynest-bench-cuda: no GPU: " << error.what() << "\n";
        return exit_no_device;
    } catch (const std::exception& error) {
        std::cerr << "raynest-bench-cuda: " << error.what() << "\n";
        return exit_failed;
    }
}
