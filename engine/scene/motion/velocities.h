// How fast the points of a scene move at a moment of an animation.
#pragma once

#include "engine/geometry/views.h"
#include "engine/scene/motion/motion.h"
#include "engine/scene/motion/skinning.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace raynest {

/// Units of the scene per second. Functions that are asked for each hit are here, for all that is
/// compiled once per CPU target. Thread-safe.
class Velocities {
public:
    /// At a key those that begin there, at the animation's end those that end there. `placed` are
    /// the outermost instances at that moment, with what edits have done to them. The tables outlive
    /// it.
    Velocities(const Motion& motion, const MotionAnimation& animation, double seconds,
               const InstanceInfo* placed);
    /// Bytes of one, and of what making it takes.
    [[nodiscard]] static std::uint64_t bytes_for(const Motion& motion);

    /// Velocity of a point of an outermost instance, as its node moves it; both in the scene.
    [[nodiscard]] glm::dvec3 of_instance(std::uint32_t outermost, const glm::dvec3& point) const {
        const auto behind = std::ranges::upper_bound(carried_, outermost, {}, &Carried::outermost);
        if (behind == carried_.begin() || (behind - 1)->outermost != outermost)
            return glm::dvec3(0);
        const Carried& by = *(behind - 1);
        return map_vector(by.turning, point - by.centre) + by.drift;
    }
    /// Velocity in a mesh whose vertices move, in its space: of the point that the shares of three
    /// corners make. The mesh is that of the outermost instance; 0 unless it is such a one.
    [[nodiscard]] glm::dvec3 of_vertices(std::uint32_t outermost, std::uint32_t geometry,
                                         const std::uint32_t* corners,
                                         const glm::dvec3& shares) const {
        glm::dvec3 sum(0);
        const auto at = std::ranges::lower_bound(places_, outermost, {}, &Place::outermost);
        if (at == places_.end() || at->outermost != outermost) return sum;
        const Bent& mesh = meshes_[at->mesh];
        if (geometry >= mesh.record->part_count) return sum;
        const MovedPart& part = motion_.parts[mesh.record->first_part + geometry];
        for (int k = 0; k < 3; ++k)
            if (corners[k] < part.vertices) sum += shares[k] * of_vertex(mesh, part, corners[k]);
        return sum;
    }

private:
    /// A point moves by `turning` of its way from `centre`, and by `drift`.
    struct Carried {
        std::uint32_t outermost = 0;
        Affine turning{};
        glm::dvec3 centre{0}, drift{0};
    };
    struct Bent {
        const MovedMesh* record = nullptr;
        std::vector<Affine> maps, map_rates;        ///< by joint
        std::vector<double> weights, weight_rates;  ///< by target
    };
    struct Place {
        std::uint32_t outermost = 0;
        std::uint32_t mesh = 0;  ///< in meshes_
    };

    [[nodiscard]] glm::dvec3 of_vertex(const Bent& mesh, const MovedPart& part,
                                       std::uint32_t vertex) const {
        const float* const floats = motion_.floats.data();
        const auto three = [&](std::size_t first) {
            const float* const v = floats + first + 3 * std::size_t{vertex};
            return glm::dvec3(v[0], v[1], v[2]);
        };
        glm::dvec3 position = three(part.positions), rate(0);
        for (std::size_t t = 0; t < mesh.weights.size(); ++t) {
            const std::uint32_t differences = motion_.targets[part.first_target + t].positions;
            if (differences == no_id) continue;
            position += mesh.weights[t] * three(differences);
            rate += mesh.weight_rates[t] * three(differences);
        }
        if (part.influences == 0) return rate;
        const std::size_t first = std::size_t{vertex} * part.influences;
        const auto blend = [&](const std::vector<Affine>& maps) {
            return blend_joints(maps, motion_.joint_numbers.data() + part.first_joint + first,
                                floats + part.first_influence + first, part.influences);
        };
        return map_point(blend(mesh.map_rates), position) + map_vector(blend(mesh.maps), rate);
    }

    const Motion motion_;
    std::vector<Carried> carried_;  ///< ascending
    std::vector<Bent> meshes_;
    std::vector<Place> places_;  ///< ascending
};

}  // namespace raynest
