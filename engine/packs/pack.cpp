// The table of one kernel pack: collects its variants and primitive types behind one symbol.
// Compiled for the baseline CPU: it answers "may this CPU run the pack?" before anything else runs.
#include "engine/geometry/record_types.h"
#include "engine/packs/abi.h"
#include "engine/packs/layout.h"

#include <array>
#include <concepts>
#include <cstdint>

namespace raynest {

#define RAYNEST_VARIANT(function) const PackVariant& function() noexcept;
#include RAYNEST_VARIANT_LIST
#undef RAYNEST_VARIANT

namespace {

template <class P>
void record_bounds(const void* records, std::uint64_t count, Box* boxes) noexcept {
    const auto* from = static_cast<const P*>(records);
    for (std::uint64_t i = 0; i < count; ++i) boxes[i] = bounds(from[i]);
}

template <class P>
void record_normal(const void* record, const float point[3], float out[3]) noexcept {
    const Vec3 n = normal(*static_cast<const P*>(record), Vec3(point[0], point[1], point[2]));
    for (int axis = 0; axis < 3; ++axis) out[axis] = n[axis];
}

/// Converts to any argument.
struct Anything {
    template <class T>
    operator T&() const;  // NOLINT(google-explicit-constructor)
    template <class T>
    operator T&&() const;  // NOLINT(google-explicit-constructor)
};
template <class P>
concept HasNormal = requires(const P& primitive, const Vec3& point) {
    { normal(primitive, point) } -> std::convertible_to<Vec3>;
};
/// True if there is a normal() of the type that takes other arguments, or returns something else.
template <class P>
concept HasOtherNormal =
    !HasNormal<P> && (
                         requires(P & primitive) { normal(primitive); } ||
                         requires(P & primitive, Anything any) { normal(primitive, any); } ||
                         requires(P & primitive, Anything any) { normal(any, primitive); } ||
                         requires(P & primitive, Anything any) { normal(primitive, any, any); });

template <class P>
constexpr PackPrimitive describe_primitive(const char* name) {
    static_assert(!HasOtherNormal<P>,
                  "normal() of a primitive is Vec3 normal(const P& primitive, const Vec3& point)");
    PackPrimitive primitive{};
    primitive.name = name;
    primitive.record_size = sizeof(P);
    primitive.hits_max =
        decltype(intersect(std::declval<const RayView&>(), std::declval<const P&>()))::lanes;
    primitive.bounds = record_bounds<P>;
    if constexpr (HasNormal<P>) {
        primitive.normal = record_normal<P>;
    }
    return primitive;
}

}  // namespace

#ifdef RAYNEST_CPU_TEST
static bool is_supported() noexcept {
    __builtin_cpu_init();
    return RAYNEST_CPU_TEST;
}
#else
bool is_supported() noexcept;  // defined by the code of a target that is no CPU
#endif

}  // namespace raynest

extern "C" [[gnu::visibility("default")]] const raynest::Pack* raynest_pack() noexcept {
    using namespace raynest;
#define RAYNEST_VARIANT(function) function(),
    static const auto variants = std::to_array<PackVariant>({
#include RAYNEST_VARIANT_LIST
    });
#undef RAYNEST_VARIANT
#define RAYNEST_PRIMITIVE(name, Type) describe_primitive<Type>(#name),
    static const auto primitives =
        std::to_array<PackPrimitive>({RAYNEST_FOR_EACH_RECORD_TYPE(RAYNEST_PRIMITIVE)});
#undef RAYNEST_PRIMITIVE
    static const auto types = border_types();
    static const Pack pack = [] {
        Pack p{};
        p.abi = pack_abi;
        p.types = types.data();
        p.type_count = static_cast<std::uint32_t>(types.size());
        p.target = RAYNEST_TARGET_NAME;
        p.supported = is_supported;
        p.variants = variants.data();
        p.variant_count = static_cast<std::uint32_t>(variants.size());
        p.primitives = primitives.data();
        p.primitive_count = static_cast<std::uint32_t>(primitives.size());
        for (const PackVariant& variant : variants) {
            p.kernel_count += variant.observe != nullptr ? 1 : 0;
            for (const auto& traversal : variant.trace) {
                for (const auto& query : traversal) {
                    for (const TraceFunction function : query) {
                        p.kernel_count += function != nullptr ? 1 : 0;
                    }
                }
            }
        }
        return p;
    }();
    return &pack;
}
