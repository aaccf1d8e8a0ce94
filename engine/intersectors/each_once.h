// Shows an intersector with outputs each surface once per ray.
//
// A tree with spatial splits names a triangle in several leaves, and the reference walks the blocks
// of the same leaves. An intersector answers the same each time, so hits do not change; what it
// adds to its outputs does. Which leaf a hit belongs to cannot be told from the hit: a grazing ray
// may be called a hit anywhere in a triangle's box (bvh/build_spatial.h), in leaves that it enters
// or not. So the triangles that a ray has met are remembered. Where no triangle is cut, and for
// intersectors without outputs, nothing is.
#pragma once

#include "engine/bvh/intersect_with.h"
#include "engine/bvh/visit_primitive.h"
#include "engine/intersectors/params.h"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <type_traits>
#include <utility>

namespace raynest {

/// The triangles that one ray has met, of all placements. Not thread-safe.
class MetTriangles {
public:
    /// Notes a triangle at the ray's level; returns false if the ray has met it before. Another ray
    /// than the last one begins with none.
    bool add(const RayView& ray, std::uint32_t triangle) {
        if (ray.world != ray_) begin(ray.world);
        if (2 * std::size_t{count_} >= size_ && !grow()) return true;
        Entry& entry = place_of(ray.path, triangle);
        if (entry.round == round_) return false;
        entry = {ray.path, triangle, round_};
        ++count_;
        return true;
    }
    /// True if there was no room to note a triangle: outputs may count it twice.
    [[nodiscard]] bool is_exhausted() const { return exhausted_; }

private:
    /// Entries of a thread: 64 MiB, for a ray that meets two million triangles.
    static constexpr std::size_t size_max = 1 << 22;

    struct Entry {
        std::uint64_t path;
        std::uint32_t triangle;
        std::uint32_t round;  ///< in use if it is the present one
    };

    void begin(const Ray* ray) {
        ray_ = ray;
        count_ = 0;
        if (++round_ != 0) return;
        for (std::size_t i = 0; i < size_; ++i) entries_[i].round = 0;
        round_ = 1;
    }
    /// Returns the entry of the triangle, or the free one where it belongs.
    [[nodiscard]] Entry& place_of(std::uint64_t path, std::uint32_t triangle) const {
        std::uint64_t hash = (path * 0x9E3779B97F4A7C15U ^ triangle) * 0xD6E8FEB86659FD93U;
        for (hash ^= hash >> 32;; ++hash) {
            Entry& entry = entries_[hash & (size_ - 1)];
            if (entry.round != round_ || (entry.triangle == triangle && entry.path == path))
                return entry;
        }
    }
    [[gnu::noinline]] bool grow() {
        const std::size_t size = size_ == 0 ? 64 : 2 * size_;
        std::unique_ptr<Entry[]> old(size <= size_max ? new (std::nothrow) Entry[size]{} : nullptr);
        if (old == nullptr) {
            exhausted_ = true;
            return false;
        }
        std::swap(entries_, old);
        const std::size_t old_size = std::exchange(size_, size);
        for (std::size_t i = 0; i < old_size; ++i) {
            if (old[i].round == round_) place_of(old[i].path, old[i].triangle) = old[i];
        }
        return true;
    }

    const Ray* ray_ = nullptr;
    std::unique_ptr<Entry[]> entries_;
    std::size_t size_ = 0;  ///< a power of two, at least twice `count_`
    std::uint32_t count_ = 0;
    std::uint32_t round_ = 0;
    bool exhausted_ = false;
};

/// Lanes that the questions of one visit have told apart.
struct Meetings {
    MetTriangles& met;
    std::uint32_t known = 0;     ///< hit by the ray
    std::uint32_t repeated = 0;  ///< hits in another leaf before
};

/// Triangles of which a ray hits those alone that it has not met in another leaf.
template <class T>
struct Once : T {
    Meetings* meetings;
    RAYNEST_INLINE Once(const T& triangles, Meetings& noted) : T(triangles), meetings(&noted) {}
};

/// An intersector may ask several times, as one does that is composed of others.
template <class R, class T>
RAYNEST_INLINE auto intersect(const R& ray, const Once<T>& triangles) {
    auto hits = intersect(ray, static_cast<const T&>(triangles));
    Meetings& meetings = *triangles.meetings;
    for_each_lane<T::lanes>(hits.mask & ~meetings.known, [&](int lane) RAYNEST_INLINE_LAMBDA {
        meetings.known |= 1U << lane;
        if (!meetings.met.add(ray, triangles.prim_of(lane))) meetings.repeated |= 1U << lane;
    });
    hits.mask &= ~meetings.repeated;
    return hits;
}

/// Asks `Base`, and shows it each triangle once per ray.
template <class Base>
struct EachOnce {
    Base& base;
    MetTriangles& met;

    template <class R, class P>
    requires Overrides<Base, R, P> RAYNEST_INLINE auto operator()(const R& ray, const P& thing) {
        if constexpr (TriangleLike<P>) {
            Meetings meetings{met};
            if (ray.scene != nullptr && ray.scene->cut_triangles != 0)
                return base(ray, Once<P>(thing, meetings));
        }
        return base(ray, thing);
    }

    template <class R, class T>
    requires requires(Base& b, const R& r, const T& t) { b.passes_by(r, t); }
    void passes_by(const R& ray, const T& instance) { base.passes_by(ray, instance); }
};

/// True if answers may tell in which order the intersector was asked.
template <class Isect>
inline constexpr bool shows_order = has_outputs<Isect>;
template <class Base>
inline constexpr bool shows_order<EachOnce<Base>> = true;

struct NoMemory {
    [[nodiscard]] static constexpr bool is_exhausted() { return false; }
};
/// The memory that a call keeps for each_once().
template <class Isect>
using MemoryOf = std::conditional_t<has_outputs<Isect>, MetTriangles, NoMemory>;

/// The intersector to ask: itself where it has no outputs. `isect` may be an adapter of it.
template <class Isect>
RAYNEST_INLINE Isect& each_once(Isect& isect, NoMemory& /*memory*/) {
    return isect;
}
template <class Isect>
RAYNEST_INLINE EachOnce<Isect> each_once(Isect& isect, MetTriangles& memory) {
    return {isect, memory};
}

}  // namespace raynest
