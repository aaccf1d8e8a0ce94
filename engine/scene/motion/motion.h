// The animations of a scene: which instances, cameras, lights and vertices move, and how.
//
//   nodes ──► instances, cameras, lights, skins' joints        channels ──► nodes and weights of meshes
//
// A scene carries them as one run of bytes, the tables below one behind the other. FORMAT.md draws
// it. Nothing here knows of files: glTF is one that such tables can be made of.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/result.h"
#include "engine/scene/motion/affine.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest {

/// Limit on the keys and vertices of all animations together, in floats.
inline constexpr std::uint64_t motion_floats_max = 1ULL << 30;
inline constexpr std::uint32_t motion_animations_max = 4096;
/// Limit on the times of keys, in seconds.
inline constexpr float motion_seconds_max = 1e6F;

struct MotionAnimation {
    std::uint32_t name = 0;  ///< offset in `names`
    std::uint32_t first_channel = 0;
    std::uint32_t channel_count = 0;
    float seconds = 0;  ///< it runs from 0 to here
};

enum class MotionPath : std::uint32_t { translation, rotation, scale, weights };

struct MotionChannel {
    std::uint32_t sampler = 0;
    std::uint32_t target = 0;  ///< a node; of weights a mesh
    MotionPath path = MotionPath::translation;
};

enum class Interpolation : std::uint32_t { step, linear, cubic };

/// Keys: `keys` times in `floats`, ascending, and as many values of `width` numbers; cubic ones
/// have three each: tangent before, value, tangent behind (glTF 2.0, appendix C).
struct MotionSampler {
    std::uint32_t first_time = 0;
    std::uint32_t keys = 0;
    std::uint32_t first_value = 0;
    std::uint32_t width = 0;
    Interpolation interpolation = Interpolation::linear;
};

/// A node, behind its parent. Only nodes with parts (has_trs) are animated.
struct MotionNode {
    std::uint32_t parent = no_id;
    std::uint32_t has_trs = 0;
    std::array<double, 10> trs{0, 0, 0, 0, 0, 0, 1, 1, 1, 1};  ///< translation, quaternion, scale
    Affine local = identity_affine;                            ///< without parts
};

/// An outermost instance that follows a node.
struct MovedInstance {
    std::uint32_t outermost = 0;
    std::uint32_t node = 0;
    Affine to_node = identity_affine;  ///< from the space of the instance's object
};

struct MovedCamera {
    std::uint32_t camera = 0;
    std::uint32_t node = 0;
};

struct MovedLight {
    std::uint32_t light = 0;
    std::uint32_t node = 0;
};

struct MotionJoint {
    std::uint32_t node = 0;
    std::uint32_t unused = 0;
    Affine bind = identity_affine;  ///< from the mesh's space to the joint's
};

/// A mesh whose vertices move: by weights of its targets, then by joints.
struct MovedMesh {
    std::uint32_t first_place = 0;  ///< outermost instances that place it, in `places`
    std::uint32_t place_count = 0;
    std::uint32_t first_part = 0;  ///< one per geometry of its object
    std::uint32_t part_count = 0;
    std::uint32_t first_joint = 0;
    std::uint32_t joint_count = 0;   ///< 0: no skin
    std::uint32_t first_weight = 0;  ///< in `floats`: the weights of the scene as it was loaded
    std::uint32_t weight_count = 0;
};

/// The vertices of one geometry before all that moves them, in `floats`.
struct MovedPart {
    std::uint32_t vertices = 0;
    std::uint32_t positions = 0;        ///< three each
    std::uint32_t normals = no_id;      ///< three each; no_id: none
    std::uint32_t tangents = no_id;     ///< four each; no_id: none
    std::uint32_t first_target = 0;     ///< one per weight of the mesh
    std::uint32_t influences = 0;       ///< joints of a vertex, a multiple of 4; 0: no skin
    std::uint32_t first_joint = 0;      ///< in `joint_numbers`
    std::uint32_t first_influence = 0;  ///< in `floats`: their weights
};

/// Differences that a target adds, three each; no_id: none.
struct MovedTarget {
    std::uint32_t positions = no_id;
    std::uint32_t normals = no_id;
    std::uint32_t tangents = no_id;
};

template <template <class> class List>
struct MotionLists {
    List<MotionAnimation> animations;
    List<MotionChannel> channels;
    List<MotionSampler> samplers;
    List<MotionNode> nodes;
    List<MovedInstance> instances;
    List<MovedCamera> cameras;
    List<MovedLight> lights;
    List<MotionJoint> joints;
    List<MovedMesh> meshes;
    List<MovedPart> parts;
    List<MovedTarget> targets;
    List<std::uint32_t> places;
    List<std::uint32_t> joint_numbers;  ///< among those of their mesh
    List<float> floats;
    List<char> names;  ///< zero-terminated

    /// Calls visit(list) for each, in the order of the bytes.
    template <class Visit>
    void each(const Visit& visit) {
        visit(animations), visit(channels), visit(samplers), visit(nodes), visit(instances);
        visit(cameras), visit(lights), visit(joints), visit(meshes), visit(parts);
        visit(targets), visit(places), visit(joint_numbers), visit(floats), visit(names);
    }
};
template <class T>
using MotionSpan = std::span<const T>;
template <class T>
using MotionVector = std::vector<T>;

/// Tables in an arena; empty for a scene that does not move.
using Motion = MotionLists<MotionSpan>;
/// Tables that are being made.
using MotionTables = MotionLists<MotionVector>;

/// Returns the bytes of tables.
std::vector<std::byte> motion_bytes(MotionTables& tables);
/// Reads tables out of bytes that stay. Empty bytes are a scene that does not move. Checks every
/// index, length and number, those of instances, cameras and lights against the scene's. Fails with
/// scene_invalid.
Result<Motion> read_motion(std::span<const std::byte> bytes, std::uint32_t outermost,
                           std::uint32_t cameras, std::uint32_t lights);
/// The same of bytes that read_motion() has accepted, without a look at them.
Motion checked_motion(std::span<const std::byte> bytes);
/// Returns the bytes after instances were removed, `removed` ascending.
std::vector<std::byte> motion_without(std::span<const std::byte> bytes,
                                      std::span<const std::uint32_t> removed);

/// Returns the name of an animation.
[[nodiscard]] inline std::string name_of(const Motion& motion, const MotionAnimation& animation) {
    return motion.names.data() + animation.name;
}
/// Is this its name? Copies nothing.
[[nodiscard]] inline bool is_named(const Motion& motion, const MotionAnimation& animation,
                                   std::string_view name) {
    const auto rest = motion.names.subspan(animation.name);
    return name.size() < rest.size() && rest[name.size()] == '\0' &&
           std::equal(name.begin(), name.end(), rest.begin());
}

}  // namespace raynest
