#include "tests/bench/edits/skin.h"

#include "engine/scene/edits/pose.h"
#include "tests/bench/edits/measured.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace raynest::bench {
namespace {

constexpr std::uint32_t joints = 4;

GeometryDescription sheet(std::uint32_t side) {
    GeometryDescription mesh;
    for (std::uint32_t y = 0; y < side; ++y)
        for (std::uint32_t x = 0; x < side; ++x) {
            const float u = static_cast<float>(x) / 10, v = static_cast<float>(y) / 10;
            mesh.positions.emplace_back(u, std::sin(u) * std::cos(v), v);
        }
    for (std::uint32_t y = 0; y + 1 < side; ++y)
        for (std::uint32_t x = 0; x + 1 < side; ++x) {
            const std::uint32_t a = y * side + x;
            mesh.indices.insert(mesh.indices.end(),
                                {a, a + 1, a + side, a + 1, a + side + 1, a + side});
        }
    return mesh;
}

/// Joint 0 moves up within a second, and all others with it, each half as far as the one before.
std::vector<std::byte> bending(const std::vector<Vec3>& corners) {
    MotionTables motion;
    const auto add = [&](const std::vector<float>& floats) {
        const auto first = static_cast<std::uint32_t>(motion.floats.size());
        motion.floats.insert(motion.floats.end(), floats.begin(), floats.end());
        return first;
    };
    const std::uint32_t times = add({0, 1});
    motion.places.push_back(0);
    MovedPart part;
    part.vertices = static_cast<std::uint32_t>(corners.size());
    part.positions = static_cast<std::uint32_t>(motion.floats.size());
    for (const Vec3& p : corners) motion.floats.insert(motion.floats.end(), {p.x, p.y, p.z});
    part.influences = joints;
    part.first_influence = add(std::vector<float>(joints * corners.size(), 1.0F / joints));
    for (std::size_t i = 0; i < corners.size(); ++i)
        for (std::uint32_t j = 0; j < joints; ++j) motion.joint_numbers.push_back(j);
    motion.parts.push_back(part);
    for (std::uint32_t j = 0; j < joints; ++j) {
        motion.nodes.emplace_back().has_trs = 1;
        motion.joints.push_back({j});
        const float far = 4 / static_cast<float>(1U << j);
        motion.samplers.push_back({times, 2, add({0, 0, 0, 0, far, 0}), 3, Interpolation::linear});
        motion.channels.push_back({j, j, MotionPath::translation});
    }
    MovedMesh mesh;
    mesh.place_count = mesh.part_count = 1;
    mesh.joint_count = joints;
    motion.meshes.push_back(mesh);
    motion.animations.push_back({0, 0, joints, 1});
    motion.names = {'b', '\0'};
    return motion_bytes(motion);
}

}  // namespace

nlohmann::json skin_figures(std::uint32_t vertices, int rounds) {
    const auto side = static_cast<std::uint32_t>(std::sqrt(static_cast<double>(vertices)));
    SceneDescription description;
    description.objects.resize(2);
    description.objects[0].geometries.push_back(sheet(side));
    description.objects[1].instances.resize(1);
    description.objects[1].instances[0].object = 0;
    description.root = 1;
    description.motion = bending(description.objects[0].geometries[0].positions);
    const double build = best_of(std::max(2, rounds / 5), [&](int) { built(description); });
    const auto scene = built(description);
    const double posed = best_of(rounds, [&](int round) {
        const auto at = pose(*scene, {0, 0.1 * (1 + round % 9)});
        if (!at) throw std::runtime_error(at.error().message);
    });
    return {{"skinned_vertices", side * side},
            {"skinned_build_cpu_seconds", build},
            {"skinned_pose_cpu_seconds", posed},
            {"skinned_pose_over_build", posed / build}};
}

}  // namespace raynest::bench
