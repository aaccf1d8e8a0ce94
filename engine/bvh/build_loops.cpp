#include "engine/bvh/build_loops.h"

#include "engine/math/mask.h"

#include <bit>
#include <limits>

// Other compilers take the baseline alone: the pragma below is GCC's.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define RAYNEST_BUILD_FOR_AVX2 1
#else
#define RAYNEST_BUILD_FOR_AVX2 0
#endif

namespace raynest::build {
namespace {

constexpr float nothing = -std::numeric_limits<float>::infinity();

/// All bits where the condition does not hold. As floats they are NaN, which no maximum takes.
inline std::int32_t unless(bool condition) {
    return static_cast<std::int32_t>(condition) - 1;
}

namespace baseline {

/// A box in two registers.
struct Whole {
    Float4 minus_lower, upper;

    static Whole of(const Extent& e) { return {e.minus_lower, e.upper}; }
    static Whole at(Float4 point) { return {-point, point}; }
    static Whole none() {
        constexpr Float4 none{nothing, nothing, nothing, nothing};
        return {none, none};
    }
    void store(Extent& e) const {
        e.minus_lower = minus_lower;
        e.upper = upper;
    }
    void extend(Extent& e) const {
        e.minus_lower = maximum(minus_lower, e.minus_lower);
        e.upper = maximum(upper, e.upper);
    }
    void extend(const Whole& other) {
        minus_lower = maximum(other.minus_lower, minus_lower);
        upper = maximum(other.upper, upper);
    }
    void extend_if(Whole other, bool condition) {
        const Int4 mask = Int4{} + unless(condition);
        other.minus_lower = std::bit_cast<Float4>(std::bit_cast<Int4>(other.minus_lower) | mask);
        other.upper = std::bit_cast<Float4>(std::bit_cast<Int4>(other.upper) | mask);
        extend(other);
    }
    [[nodiscard]] Float4 size() const { return minus_lower + upper; }
};

#include "engine/bvh/build_loops_of_target.h"

}  // namespace baseline

#if RAYNEST_BUILD_FOR_AVX2
// A pragma and not a source file with flags of its own: what headers define inline would then be
// compiled twice under one name, and the linker might keep the one that not every CPU can run.
#pragma GCC push_options
#pragma GCC target("avx2")
namespace avx2 {

/// A box in one register, loaded as one: two halves that were stored apart would be waited for.
struct Whole {
    using Float8 = float __attribute__((vector_size(32), may_alias));
    using Int8 = std::int32_t __attribute__((vector_size(32)));
    Float8 lanes;

    static Whole of(const Extent& e) { return {*reinterpret_cast<const Float8*>(&e)}; }
    static Whole at(Float4 point) {
        return {__builtin_shufflevector(-point, point, 0, 1, 2, 3, 4, 5, 6, 7)};
    }
    static Whole none() {
        return {Float8{nothing, nothing, nothing, nothing, nothing, nothing, nothing, nothing}};
    }
    void store(Extent& e) const { *reinterpret_cast<Float8*>(&e) = lanes; }
    void extend(Extent& e) const {
        Whole both = of(e);
        both.extend(*this);
        both.store(e);
    }
    void extend(const Whole& other) { lanes = other.lanes > lanes ? other.lanes : lanes; }
    void extend_if(Whole other, bool condition) {
        const Int8 mask = Int8{} + unless(condition);
        other.lanes = std::bit_cast<Float8>(std::bit_cast<Int8>(other.lanes) | mask);
        extend(other);
    }
    [[nodiscard]] Float4 size() const {
        return __builtin_shufflevector(lanes, lanes, 0, 1, 2, 3) +
               __builtin_shufflevector(lanes, lanes, 4, 5, 6, 7);
    }
};

#include "engine/bvh/build_loops_of_target.h"

}  // namespace avx2
#pragma GCC pop_options
#endif

}  // namespace

std::span<const Loops> loops() {
    static constexpr Loops all[] = {
        {"baseline", baseline::bin_all, baseline::bin_all_cells, baseline::cheapest_plane,
         baseline::partition_all},
#if RAYNEST_BUILD_FOR_AVX2
        {"avx2", avx2::bin_all, avx2::bin_all_cells, avx2::cheapest_plane, avx2::partition_all},
#endif
    };
    const std::span<const Loops> known(all);
#if RAYNEST_BUILD_FOR_AVX2
    if (__builtin_cpu_supports("avx2") == 0) return known.first(1);
#endif
    return known;
}

}  // namespace raynest::build
