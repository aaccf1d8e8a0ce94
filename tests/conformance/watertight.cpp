// Checks that no ray slips through a closed mesh: from inside, every ray must hit.
//
//   watertight [RAYS]      rays per (target, traversal, depth); default 200000
//
// The mesh is a bumpy ball of thin and tiny triangles that share their vertices. Rays are aimed at
// its vertices, at points of its edges and anywhere. At depths above 1 the ball is under rotated
// and sheared instances. Exits 1 on any miss.
#include "engine/scene/snapshot.h"
#include "tests/conformance/scenes.h"
#include "tests/conformance/targets.h"
#include "tests/sanitized.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <string>
#include <vector>

namespace raynest::conformance {
namespace {

struct Ball {
    SceneDescription scene;
    std::vector<Vec3> targets;  // in world space
};

// Build latitudes and longitudes; the poles are fans of needles. A random corner of each triangle
// comes first, so that edges have every pair of roles in their two triangles: a rule that is wrong
// for one role alone loses rays.
GeometryDescription ball_mesh(std::uint32_t rings, std::uint32_t sectors, Random& random) {
    GeometryDescription mesh;
    mesh.positions.emplace_back(0, 0, 3);
    for (std::uint32_t ring = 1; ring < rings; ++ring) {
        const float polar =
            std::numbers::pi_v<float> * static_cast<float>(ring) / static_cast<float>(rings);
        for (std::uint32_t sector = 0; sector < sectors; ++sector) {
            const float turn = 2 * std::numbers::pi_v<float> * static_cast<float>(sector) /
                               static_cast<float>(sectors);
            const float radius = random.between(2.5F, 3.5F);
            mesh.positions.push_back(radius * Vec3(std::sin(polar) * std::cos(turn),
                                                   std::sin(polar) * std::sin(turn),
                                                   std::cos(polar)));
        }
    }
    mesh.positions.emplace_back(0, 0, -3);
    const auto last = static_cast<std::uint32_t>(mesh.positions.size()) - 1;
    const auto vertex = [&](std::uint32_t ring, std::uint32_t sector) {
        if (ring == 0) return 0U;
        return ring == rings ? last : 1 + (ring - 1) * sectors + sector % sectors;
    };
    const auto add = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
        std::array corners = {a, b, c};
        std::rotate(corners.begin(), corners.begin() + random.below(3), corners.end());
        mesh.indices.insert(mesh.indices.end(), corners.begin(), corners.end());
    };
    for (std::uint32_t ring = 0; ring < rings; ++ring) {
        for (std::uint32_t sector = 0; sector < sectors; ++sector) {
            const std::uint32_t a = vertex(ring, sector);
            const std::uint32_t b = vertex(ring + 1, sector);
            const std::uint32_t c = vertex(ring + 1, sector + 1);
            const std::uint32_t d = vertex(ring, sector + 1);
            // At a pole, two of the four corners coincide.
            if (ring + 1 < rings) add(a, b, c);
            if (ring > 0) add(a, c, d);
        }
    }
    return mesh;
}

Ball make_ball(std::uint32_t depth, Random& random) {
    Ball ball;
    GeometryDescription mesh = ball_mesh(96, 97, random);
    ball.targets = mesh.positions;
    for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
        const float along = random.unit();
        ball.targets.push_back((1 - along) * mesh.positions[mesh.indices[i]] +
                               along * mesh.positions[mesh.indices[i + 1]]);
    }
    ball.scene.objects.resize(depth);
    ball.scene.objects[0].geometries.push_back(std::move(mesh));
    for (std::uint32_t level = 1; level < depth; ++level) {
        Transform place;
        for (std::size_t i = 0; i < 12; ++i) {
            place.m[i] += random.between(-0.3F, 0.3F);
        }
        InstanceDescription instance;
        instance.object = level - 1;
        instance.transform = place;
        ball.scene.objects[level].instances.push_back(instance);
        for (Vec3& point : ball.targets) point = place.point(point);
    }
    ball.scene.root = depth - 1;
    return ball;
}

std::vector<Ray> rays_from_inside(const Ball& ball, std::uint32_t count, Random& random) {
    Vec3 centre{0.0F};
    for (const Vec3& target : ball.targets)
        centre += target / static_cast<float>(ball.targets.size());
    std::vector<Ray> rays(count);
    for (std::uint32_t i = 0; i < count; ++i) {
        // Groups of 64 rays share an origin and aim at neighbouring points, so that packets are
        // traversed.
        const std::uint32_t group = i / 64;
        Random shared(group);
        rays[i].origin = centre + shared.in_box(0.2F);
        const auto first = shared.below(static_cast<std::uint32_t>(ball.targets.size()));
        const std::size_t target = (first + i % 64) % ball.targets.size();
        rays[i].direction =
            group % 4 == 3 ? random.direction() : ball.targets[target] - rays[i].origin;
    }
    return rays;
}

std::uint64_t misses(TraceFunction function, const SceneView& view, const std::vector<Ray>& rays,
                     std::vector<HitRecord>& hits) {
    hits.assign(rays.size(), HitRecord{});
    TraceCall call{};
    call.scene = &view;
    call.rays = rays.data();
    call.ray_count = static_cast<std::uint32_t>(rays.size());
    call.hits_max = 1;
    call.mask = 0xFFFFFFFFU;
    call.hits = hits.data();
    if (function(&call) != trace_ok) return rays.size();
    const auto lost =
        std::count_if(hits.begin(), hits.end(), [](const HitRecord& hit) { return hit.hit == 0; });
    return static_cast<std::uint64_t>(lost);
}

int main_checked(std::uint32_t count) {
    std::uint64_t traced = 0;
    std::uint64_t missed = 0;
    Random random(11);
    std::vector<HitRecord> hits;
    for (const std::uint32_t depth : {1U, 2U, 4U}) {
        const Ball ball = make_ball(depth, random);
        const auto scene = Snapshot::build(ball.scene);
        if (!scene) {
            std::printf("FAILED: %s\n", scene.error().message.c_str());
            return 1;
        }
        const std::vector<Ray> rays = rays_from_inside(ball, count, random);
        for (const char* target : targets) {
            const auto registry = registry_of(target);
            if (registry == nullptr) continue;
            const Variant& opaque = *registry->find("opaque");
            for (const Query query : {query_closest, query_any}) {
                for (std::uint32_t t = 0; t < traversal_reference; ++t) {
                    const auto function = find_function(opaque, query, static_cast<Traversal>(t));
                    if (!function) continue;
                    const std::uint64_t lost = misses(*function, (*scene)->view(), rays, hits);
                    traced += rays.size();
                    missed += lost;
                    if (lost != 0) {
                        std::printf(
                            "FAILED: %s depth %u query %u traversal %u: %llu rays slipped "
                            "through\n",
                            target, depth, query, t, static_cast<unsigned long long>(lost));
                    }
                }
            }
        }
    }
    std::printf("watertight: %llu rays from inside closed meshes, %llu slipped through\n",
                static_cast<unsigned long long>(traced), static_cast<unsigned long long>(missed));
    return traced != 0 && missed == 0 ? 0 : 1;
}

}  // namespace
}  // namespace raynest::conformance

int main(int argc, char** argv) {
    return raynest::conformance::main_checked(argc > 1
                                                  ? static_cast<std::uint32_t>(std::stoul(argv[1]))
                                                  : raynest::test::sanitized_share(200'000U, 50U));
}
