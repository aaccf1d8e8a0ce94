// raynest-bench-arena: writes a scene of raynest-bench as the arena that a worker maps, and rays.
//
//   raynest-bench-arena builtin:forest forest.arena --rays primary=forest.rays --count 65536
#include "engine/assets/builtin/builtin.h"
#include "engine/packs/registry.h"
#include "tests/bench/rays.h"
#include "tests/bench/value_of.h"
#include "tests/bench/workload.h"
#include "tests/cuda/gpu/options.h"

#include <exception>
#include <fstream>
#include <iostream>
#include <span>
#include <stdexcept>
#include <vector>

namespace raynest::bench {
namespace {

constexpr std::uint64_t flat_triangles_max = 4'000'000;

void write(std::ofstream& file, std::span<const std::byte> bytes) {
    file.write(reinterpret_cast<const char*>(bytes.data()),
               static_cast<std::streamsize>(bytes.size()));
}

std::ofstream create(const std::string& path) {
    std::ofstream file(path, std::ios::binary);
    file.exceptions(std::ios::failbit | std::ios::badbit);
    return file;
}

void run(const ArenaOptions& options) {
    const auto registry = value_of(Registry::load({}));
    Workload workload = value_of(load_workload(options.source, *registry));
    if (options.levels != 0) {
        const auto flat = flatten_levels(workload.description, options.levels, flat_triangles_max);
        if (!flat) throw std::runtime_error(flat.error().message);
        workload.scene = value_of(Snapshot::build(workload.description));
    }
    std::ofstream arena = create(options.arena);
    write(arena, workload.scene->bytes());
    arena.flush();

    // Diffuse and other secondary rays start where opaque ones ended.
    const Variant* const opaque = value_of(registry->choose("opaque", workload.scene->view()));
    const TraceFunction trace = value_of(find_function(*opaque, query_closest, traversal_single));
    for (const std::string& wanted : options.rays) {
        const std::size_t equals = wanted.find('=');
        if (equals == std::string::npos)
            throw std::runtime_error("--rays must be KIND=FILE, not '" + wanted + "'");
        const RayKind kind = value_of(parse_ray_kind(wanted.substr(0, equals)));
        const std::vector<Ray> rays = make_rays(workload, kind, options.count, trace);
        const auto count = static_cast<std::uint32_t>(rays.size());
        std::ofstream file = create(wanted.substr(equals + 1));
        write(file, std::as_bytes(std::span(&count, 1)));
        write(file, std::as_bytes(std::span(rays)));
        file.flush();
    }
}

}  // namespace
}  // namespace raynest::bench

int main(int argc, char** argv) {
    const auto parsed = raynest::bench::parse_arena_options(argc, argv);
    if (!parsed.options) return parsed.exit_code;
    try {
        raynest::bench::run(*parsed.options);
    } catch (const std::exception& error) {
        std::cerr << "raynest-bench-arena: " << error.what() << "\n";
        return 1;
    }
}
