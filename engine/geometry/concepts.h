// The arguments of an intersector: boxes and primitives, one or several at a time.
//
// Lanes are lanes: one ray against one triangle, one ray against eight boxes. An intersector is
// written once with `const auto& ray, const TriangleLike auto& triangle` and sees every width.
#pragma once

#include <type_traits>

namespace raynest {

/// A box or the eight boxes of a node.
template <class T>
concept BoxLike = requires {
    typename std::remove_cvref_t<T>::box_tag;
};

/// A triangle or a block of eight.
template <class T>
concept TriangleLike = requires {
    typename std::remove_cvref_t<T>::triangle_tag;
};

/// One primitive of another type: a sphere, or a type of the user's.
template <class T>
concept RecordLike = requires {
    typename std::remove_cvref_t<T>::record_tag;
};

/// Anything that can itself be hit, as opposed to a box around it.
template <class T>
concept PrimitiveLike = TriangleLike<T> || RecordLike<T>;

/// A placement of a BVH.
template <class T>
concept InstanceLike = requires {
    typename std::remove_cvref_t<T>::instance_tag;
};

}  // namespace raynest
