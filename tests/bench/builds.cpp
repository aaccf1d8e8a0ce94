#include "tests/bench/builds.h"

#include "engine/bvh/build.h"
#include "engine/bvh/node.h"
#include "engine/geometry/triangle.h"
#include "tests/bench/clock.h"
#include "tests/bench/report.h"

#include <nlohmann/json.hpp>
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/parallel_for.h>
#include <time.h>

#include <array>
#include <functional>
#include <span>
#include <utility>
#include <vector>

namespace raynest::bench {
namespace {

struct BuildTime {
    double wall_seconds;
    double cpu_seconds;  ///< the whole process's
};

BuildTime timed(const std::function<void()>& build) {
    const double wall = seconds_of(CLOCK_MONOTONIC);
    const double cpu = seconds_of(CLOCK_PROCESS_CPUTIME_ID);
    build();
    return {seconds_of(CLOCK_MONOTONIC) - wall, seconds_of(CLOCK_PROCESS_CPUTIME_ID) - cpu};
}

/// Pointers to the corners of a triangle.
using CornersAt = std::array<const Vec3*, 3>;

/// Those of every triangle of the scene's one object, in flat order; not timed.
std::vector<CornersAt> corners_of(const SceneDescription& scene) {
    std::vector<CornersAt> corners;
    for (const GeometryDescription& geometry : scene.objects[scene.root].geometries) {
        for (std::size_t i = 0; i < geometry.indices.size(); i += 3) {
            const auto corner = [&](std::size_t k) {
                return &geometry.positions[geometry.indices[i + k]];
            };
            corners.push_back({corner(0), corner(1), corner(2)});
        }
    }
    return corners;
}

/// Calls work(i) for i in [0, count) on the threads that are allowed.
template <class Work>
void in_parallel(std::size_t count, Work&& work) {
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, count, 4096),
                      [&](const tbb::blocked_range<std::size_t>& range) {
                          for (std::size_t i = range.begin(); i != range.end(); ++i) work(i);
                      });
}

/// Boxes of the triangles, the tree over them and its filled leaves: what the peer's commit does.
void build_leaves(std::span<const CornersAt> corners, BuildQuality quality) {
    PageVector<Corners> clipped(quality == BuildQuality::high ? corners.size() : 0);
    in_parallel(clipped.size(), [&](std::size_t i) {
        clipped[i] = {*corners[i][0], *corners[i][1], *corners[i][2]};
    });
    const auto boxes = [&](std::uint32_t first, std::span<Box> out) {
        for (Box& box : out) {
            box = {};
            for (const Vec3* corner : corners[first++]) box.extend(*corner);
        }
    };
    const Tree tree =
        build_tree({{}, static_cast<std::uint32_t>(corners.size()), 0, 0, quality, clipped, boxes});
    PageVector<TriangleBlock> blocks(tree.block_lanes.size() / 8);
    in_parallel(blocks.size(), [&](std::size_t block) {
        for (std::size_t lane = 0; lane < 8; ++lane) {
            const std::uint32_t triangle = tree.block_lanes[8 * block + lane];
            blocks[block].triangle[lane] = triangle;
            for (std::size_t k = 0; k < 3; ++k) {
                const Vec3 corner = triangle == no_id ? Vec3(0) : *corners[triangle][k];
                for (int axis = 0; axis < 3; ++axis) {
                    blocks[block].vertex[k][axis][lane] = corner[axis];
                }
            }
        }
    });
}

struct Stage {
    const char* name;
    std::function<void()> build;
};

std::uint64_t triangles_of(const Loaded& loaded) {
    return loaded.workload.scene->statistics().unique_triangles;
}

/// Rounds of every stage and of the peer in turn.
Result<void> race_build(const Options& options, Loaded& loaded, BuildQuality quality,
                        unsigned threads) {
    SceneDescription& scene = loaded.workload.description;
    scene.build = quality;
    const std::vector<CornersAt> corners = corners_of(scene);
    // The scene was built before: it cannot fail now.
    const std::array<Stage, 2> stages{
        {{"tree", [&] { build_leaves(corners, quality); }},
         {"scene", [&] { static_cast<void>(Snapshot::build(scene)); }}}};
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    std::array<std::vector<BuildTime>, 2> ours;
    std::vector<std::vector<PeerBuild>> theirs(loaded.peers.size());
    for (int round = 0; round < options.rounds; ++round) {
        for (std::size_t i = 0; i < stages.size(); ++i) {
            ours[i].push_back(timed(stages[i].build));
        }
        for (std::size_t peer = 0; peer < theirs.size(); ++peer) {
            const auto build =
                loaded.peers[peer]->build(loaded.workload.scene->view(), quality, threads);
            if (!build && build.error().code == ErrorCode::variant_unknown) continue;
            if (!build) return tl::unexpected(build.error());
            theirs[peer].push_back(*build);
        }
    }
    const auto median_of = [](const auto& times, auto member) {
        std::vector<double> values;
        for (const auto& time : times) values.push_back(time.*member);
        return median(std::move(values));
    };
    for (std::size_t i = 0; i < stages.size(); ++i) {
        nlohmann::ordered_json row{
            {"scene", loaded.workload.name},
            {"kind", "build"},
            {"stage", stages[i].name},
            {"build", build_quality_names[static_cast<std::size_t>(quality)]},
            {"threads", threads},
            {"triangles", triangles_of(loaded)},
            {"wall_seconds", median_of(ours[i], &BuildTime::wall_seconds)},
            {"cpu_seconds", median_of(ours[i], &BuildTime::cpu_seconds)}};
        const auto print = [&](nlohmann::ordered_json made) {
            made["rounds"] = options.rounds;
            print_object(options, std::move(made));
        };
        bool compared = false;
        for (std::size_t peer = 0; peer < theirs.size(); ++peer) {
            if (theirs[peer].empty()) continue;
            std::vector<double> wall;
            std::vector<double> cpu;
            for (std::size_t round = 0; round < theirs[peer].size(); ++round) {
                wall.push_back(theirs[peer][round].wall_seconds / ours[i][round].wall_seconds);
                cpu.push_back(theirs[peer][round].cpu_seconds / ours[i][round].cpu_seconds);
            }
            nlohmann::ordered_json against = row;
            against["peer"] = loaded.peers[peer]->name();
            against["peer_about"] = loaded.peers[peer]->about();
            against["peer_wall_seconds"] = median_of(theirs[peer], &PeerBuild::wall_seconds);
            against["peer_cpu_seconds"] = median_of(theirs[peer], &PeerBuild::cpu_seconds);
            against["ratio"] = median(std::move(wall));
            against["ratio_cpu"] = median(std::move(cpu));
            print(std::move(against));
            compared = true;
        }
        if (!compared) print(std::move(row));
    }
    return {};
}

struct Weights {
    double mesh_bytes = 0;
    double instance_bytes = 0;
    std::uint64_t instances = 0;
};

/// Share of an object's leaves that are instances: its nodes are shared out by it where a tree
/// holds a ground mesh and instances.
double instance_share(const SceneView& view, const ObjectRecord& object) {
    std::uint64_t leaves = 0;
    for (std::uint32_t i = 0; i < object.node_count; ++i) {
        for (const std::uint32_t child : view.nodes[object.first_node + i].child) {
            leaves += child != child_empty && is_leaf(child) ? 1U : 0U;
        }
    }
    return leaves != 0 ? object.instance_count / static_cast<double>(leaves) : 0;
}

Weights weigh(const SceneView& view) {
    Weights weights;
    for (std::uint32_t i = 0; i < view.object_count; ++i) {
        const ObjectRecord& object = view.objects[i];
        const double nodes = static_cast<double>(object.node_count * sizeof(Node));
        const std::size_t block = sizeof(TriangleBlock) +
                                  (object.texcoord_blocks != no_offset ? sizeof(TexcoordBlock) : 0);
        const double blocks = static_cast<double>(object.block_count * block);
        const double share = instance_share(view, object);
        constexpr std::size_t records = sizeof(InstanceRecord) + sizeof(InstanceInfo);
        weights.mesh_bytes += blocks + (1 - share) * nodes;
        weights.instance_bytes +=
            share * nodes + static_cast<double>(object.instance_count * records);
        weights.instances += object.instance_count;
    }
    return weights;
}

Result<void> print_memory(const Options& options, Loaded& loaded) {
    const Weights weights = weigh(loaded.workload.scene->view());
    const auto per = [](auto bytes, std::uint64_t count) {
        return count != 0 ? static_cast<double>(bytes) / static_cast<double>(count) : 0.0;
    };
    nlohmann::ordered_json row{
        {"scene", loaded.workload.name},
        {"kind", "memory"},
        {"triangles", triangles_of(loaded)},
        {"bytes_per_triangle", per(weights.mesh_bytes, triangles_of(loaded))},
        {"instances", weights.instances},
        {"bytes_per_instance", per(weights.instance_bytes, weights.instances)}};
    for (const auto& peer : loaded.peers) {
        const SceneView& view = loaded.workload.scene->view();
        const auto memory = peer->weigh(view);
        if (!memory && memory.error().code == ErrorCode::variant_unknown) continue;
        if (!memory) return tl::unexpected(memory.error());
        // A peer with one level holds every placed leaf.
        const std::uint64_t leaves = loaded.workload.scene->statistics().instances;
        const std::uint32_t triangles = view.objects[view.root].triangle_count;
        row["peer"] = peer->name();
        row["peer_about"] = peer->about();
        row["peer_bytes_per_triangle"] = per(memory->tree_bytes, triangles);
        row["peer_reported_bytes_per_triangle"] = per(memory->reported_bytes, triangles);
        row["peer_bytes_per_instance"] =
            per(memory->instance_bytes, weights.instances != 0 ? leaves : 0);
    }
    print_object(options, std::move(row));
    return {};
}

}  // namespace

Result<bool> race_builds(const Options& options, Loaded& loaded) {
    // First, while the process has freed little that could be reused unseen.
    if (auto done = print_memory(options, loaded); !done) return tl::unexpected(done.error());
    // The peer's commit of a root is no match for all the trees of an instanced scene.
    if (loaded.workload.scene->statistics().levels > 1) return true;
    for (const BuildQuality quality : options.qualities) {
        for (const unsigned threads : options.threads) {
            if (auto done = race_build(options, loaded, quality, threads); !done) {
                return tl::unexpected(done.error());
            }
        }
    }
    return true;
}

}  // namespace raynest::bench
