// The trees that a GPU reads instead of a CPU's nodes and blocks: an eight-wide node of 96 bytes,
// whose boxes are bytes on a grid of the node, and consecutive triangles.
//
//   origin x y z | exponent x y z, valid | child[8] | lower x[8] y[8] z[8] | upper x[8] y[8] z[8]
//
// The layout follows Ylitie, Karras, Laine, "Efficient incoherent ray traversal on GPUs through
// compressed wide BVHs" (2017), with three differences. First, child words are those of bvh/node.h,
// so that nodes are numbered as on the CPU and leaves name the same ranges. The node is therefore
// 96 bytes instead of 80, which is the same three 32-byte sectors. Second, a plane is one
// permutation of bytes and one fma, without an integer conversion: the byte becomes the mantissa of
// a float between 1 and 1 + 2^-7, and `origin` and the scale are adjusted to that float. Third,
// planes are decoded before the box rule reads them, so the rule and its monotonicity
// (geometry/slabs.h) hold unchanged. A decoded box contains the true one (cuda/compress.h ensures
// it), so it culls nothing that the true one would not.
//
// As far as possible, slot s is on the far side of its siblings along axis a where bit a of s is
// set: `s ^ octant` is the order in which a ray meets the slots.
#pragma once

#include "engine/bvh/node.h"
#include "engine/geometry/box.h"
#include "engine/geometry/box_ray.h"
#include "engine/geometry/concepts.h"
#include "engine/geometry/intersection.h"
#include "engine/math/lanes.h"

#include <bit>
#include <cmath>
#include <cstdint>

namespace raynest::cuda {

/// Loads 16 bytes at a time; on a GPU through the read-only cache.
template <class T>
[[nodiscard]] RAYNEST_INLINE T load(const T* from) {
    static_assert(alignof(T) % 16 == 0 && sizeof(T) % 16 == 0);
#ifdef __CUDA_ARCH__
    struct Quads {
        uint4 quad[sizeof(T) / 16];
    } quads;
    for (unsigned i = 0; i < sizeof(T) / 16; ++i) {
        quads.quad[i] = __ldg(reinterpret_cast<const uint4*>(from) + i);
    }
    return std::bit_cast<T>(quads);
#else
    return *from;
#endif
}

/// Returns byte `i` of `word` as the float 1 + byte * 2^-15.
[[nodiscard]] RAYNEST_INLINE float grid_value(std::uint32_t word, std::uint32_t i) {
    constexpr std::uint32_t one = std::bit_cast<std::uint32_t>(1.0F);
#ifdef __CUDA_ARCH__
    return __uint_as_float(__byte_perm(word, one, 0x7604U | i << 4));
#else
    return std::bit_cast<float>(one | (word >> (8 * i) & 255U) << 8);
#endif
}

/// Returns a plane of a grid. The product is exact, so a host without fma decodes the same bits.
[[nodiscard]] RAYNEST_INLINE float grid_plane(float origin, std::uint32_t exponent, float value) {
    return fused(value, std::bit_cast<float>(exponent << 23), origin);
}

/// The boxes of a node: everything that a box test needs, half of the node.
struct alignas(32) CompressedBoxes {
    float origin[3];
    std::uint8_t exponent[3];  ///< the scale's exponent, biased as in a float
    std::uint8_t valid;        ///< slots in use
    std::uint32_t lower[3][2];
    std::uint32_t upper[3][2];
};

struct alignas(32) CompressedNode {
    CompressedBoxes boxes;
    std::uint32_t child[8];
};
static_assert(sizeof(CompressedNode) == 96);

/// One child's box relative to a ray. The words of the planes that the ray meets first are chosen
/// once per node; a box is only computed if an intersector asks for it.
struct CompressedBox {
    using box_tag = void;
    static constexpr int lanes = 1;
    const CompressedBoxes* boxes;
    std::uint32_t slot;

    [[nodiscard]] RAYNEST_INLINE std::uint32_t valid() const { return 1; }
    [[nodiscard]] RAYNEST_FN Box box_of(int) const {
        return {{plane(boxes->lower, 0), plane(boxes->lower, 1), plane(boxes->lower, 2)},
                {plane(boxes->upper, 0), plane(boxes->upper, 1), plane(boxes->upper, 2)}};
    }
    [[nodiscard]] RAYNEST_INLINE float plane(const std::uint32_t (&words)[3][2], int axis) const {
        return grid_plane(boxes->origin[axis], boxes->exponent[axis],
                          grid_value(words[axis][slot >> 2], slot & 3U));
    }
};

/// The box rule. fmin and fmax ignore NaN, which an axis without bounds decodes to: it limits
/// nothing.
[[nodiscard]] RAYNEST_INLINE Spans<CompressedBox, 1> intersect(const BoxRay& ray,
                                                               const CompressedBox& box) {
    const Slabs& slabs = ray.slabs;
    float near = ray.tmin;
    float far = ray.tmax;
    for (int axis = 0; axis < 3; ++axis) {
        const float lower = box.plane(box.boxes->lower, axis);
        const float upper = box.plane(box.boxes->upper, axis);
        const bool backwards = slabs.is_backwards(axis);
        const auto first = Lanes<1>::splat(backwards ? upper : lower);
        const auto last = Lanes<1>::splat(backwards ? lower : upper);
        near = std::fmax(near, slabs.near_plane(axis, first).lane[0]);
        far = std::fmin(far, slabs.far_plane(axis, last).lane[0]);
    }
    return {static_cast<std::uint32_t>(near <= far), Lanes<1>::splat(near), box};
}

/// The corners as vectors of 16 bytes.
struct alignas(16) DeviceTriangle {
    Vec3 v0;
    std::uint32_t triangle;  ///< flat index in the object; no_id ends a block
    Vec3 v1;
    std::uint32_t unused1;
    Vec3 v2;
    std::uint32_t unused2;
};
static_assert(sizeof(DeviceTriangle) == 48);

/// A triangle in registers.
struct TriangleValue {
    using triangle_tag = void;
    static constexpr int lanes = 1;
    DeviceTriangle value;

    /// Returns corner k's coordinate. Selected, not addressed: an address would put the corners
    /// into memory.
    template <int N>
    [[nodiscard]] RAYNEST_INLINE Lanes<N> coordinate(int k, std::uint32_t axis) const {
        const Vec3& v = k == 0 ? value.v0 : k == 1 ? value.v1 : value.v2;
        return Lanes<N>::splat(axis == 0 ? v.x : axis == 1 ? v.y : v.z);
    }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t valid() const { return 1; }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t prim_of(int) const { return value.triangle; }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t geom_of(int) const { return 0; }
};

/// The trees of a scene's objects; ObjectRecord says where each one starts.
struct CompressedTrees {
    const CompressedNode* nodes;
    const DeviceTriangle* triangles;  ///< eight entries per block

    /// Number of entries of the traversal's stack. cuda/compress.h computes how many a scene needs.
    static constexpr std::uint32_t stack_max = 48;

    /// The tree of one object.
    struct Tree {
        const CompressedNode* nodes;
        const DeviceTriangle* triangles;

        [[nodiscard]] RAYNEST_INLINE std::uint32_t child(std::uint32_t node,
                                                         std::uint32_t slot) const {
            return nodes[node].child[slot];
        }
        /// Returns a mask: bit (s ^ octant), with the ray's octant, is set if the ray enters slot
        /// s.
        template <class Isect>
        [[nodiscard]] RAYNEST_INLINE std::uint32_t entered(std::uint32_t node, const BoxRay& ray,
                                                           Isect& isect) const {
            const CompressedBoxes boxes = load(&nodes[node].boxes);
            std::uint32_t mask = 0;
            for (std::uint32_t slot = 0; slot < 8; ++slot) {
                const std::uint32_t hit =
                    intersect_with(isect, ray, CompressedBox{&boxes, slot}).mask;
                mask |= (hit & boxes.valid >> slot) << (slot ^ ray.slabs.octant);
            }
            return mask;
        }
        /// Calls visitor(triangle) until it returns true.
        template <class Visitor>
        [[nodiscard]] RAYNEST_INLINE bool visit_triangles(std::uint32_t leaf,
                                                          Visitor&& visitor) const {
            const DeviceTriangle* at = triangles + 8 * std::size_t{leaf_first(leaf)};
            for (std::uint32_t block = 0; block < leaf_count(leaf); ++block) {
                for (std::uint32_t i = 0; i < 8; ++i) {
                    const TriangleValue triangle{load(at + 8 * block + i)};
                    if (triangle.value.triangle == no_id) break;
                    if (visitor(triangle)) return true;
                }
            }
            return false;
        }
    };
    [[nodiscard]] RAYNEST_INLINE Tree of(const ObjectRecord& object) const {
        return {nodes + object.first_node, triangles + 8 * object.first_block};
    }
};

}  // namespace raynest::cuda
