// Embree 3 and 4 behind one small set of names: they differ in how a query carries its filter and
// its flags.
#pragma once

#if RAYNEST_EMBREE == 4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include <cstdint>

namespace raynest::bench {

// The library uses the instructions of the module's target, as our kernels do, and packets have its
// native width: wider ones it traces ray by ray.
#if defined(__AVX512F__)
inline constexpr const char* device_options =
    "set_affinity=0,frequency_level=simd512,hugepages=1,threads=";
using RayPacket = RTCRay16;
using RayHitPacket = RTCRayHit16;
#define RAYNEST_EMBREE_PACKET(name) name##16
#elif defined(__AVX2__)
inline constexpr const char* device_options =
    "isa=avx2,set_affinity=0,frequency_level=simd256,hugepages=1,threads=";
using RayPacket = RTCRay8;
using RayHitPacket = RTCRayHit8;
#define RAYNEST_EMBREE_PACKET(name) name##8
#else
inline constexpr const char* device_options =
    "isa=sse4.2,set_affinity=0,frequency_level=simd128,hugepages=1,threads=";
using RayPacket = RTCRay4;
using RayHitPacket = RTCRayHit4;
#define RAYNEST_EMBREE_PACKET(name) name##4
#endif
inline constexpr std::uint32_t packet_rays = sizeof(RayPacket::tfar) / sizeof(float);

/// A query in flight. Filters get its address back as `context` and may cast it to what they
/// derived from it.
#if RAYNEST_EMBREE == 4

struct Asker : RTCRayQueryContext {
    Asker(bool coherent, RTCFilterFunctionN filter) {
        rtcInitRayQueryContext(this);
        rtcInitIntersectArguments(&intersect_);
        rtcInitOccludedArguments(&occluded_);
        const RTCRayQueryFlags flags =
            coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
        intersect_.flags = occluded_.flags = flags;
        intersect_.filter = occluded_.filter = filter;
        intersect_.context = occluded_.context = this;
        intersect_.feature_mask = occluded_.feature_mask =
            static_cast<RTCFeatureFlags>(RTC_FEATURE_FLAG_TRIANGLE | RTC_FEATURE_FLAG_INSTANCE |
                                         RTC_FEATURE_FLAG_FILTER_FUNCTION);
    }
    Asker(const Asker&) = delete;
    Asker& operator=(const Asker&) = delete;

    void closest(RTCScene scene, RTCRayHit& ray) { rtcIntersect1(scene, &ray, &intersect_); }
    void any(RTCScene scene, RTCRay& ray) { rtcOccluded1(scene, &ray, &occluded_); }
    void closest(const int* valid, RTCScene scene, RayHitPacket& rays) {
        RAYNEST_EMBREE_PACKET(rtcIntersect)(valid, scene, &rays, &intersect_);
    }
    void any(const int* valid, RTCScene scene, RayPacket& rays) {
        RAYNEST_EMBREE_PACKET(rtcOccluded)(valid, scene, &rays, &occluded_);
    }

private:
    RTCIntersectArguments intersect_;
    RTCOccludedArguments occluded_;
};

inline constexpr RTCSceneFlags argument_filter_flag = RTC_SCENE_FLAG_FILTER_FUNCTION_IN_ARGUMENTS;
inline void take_argument_filter(RTCGeometry geometry) {
    rtcSetGeometryEnableFilterFunctionFromArguments(geometry, true);
}

#else

struct Asker : RTCIntersectContext {
    Asker(bool coherent, RTCFilterFunctionN argument_filter) {
        rtcInitIntersectContext(this);
        flags =
            coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
        filter = argument_filter;
    }
    Asker(const Asker&) = delete;
    Asker& operator=(const Asker&) = delete;

    void closest(RTCScene scene, RTCRayHit& ray) { rtcIntersect1(scene, this, &ray); }
    void any(RTCScene scene, RTCRay& ray) { rtcOccluded1(scene, this, &ray); }
    void closest(const int* valid, RTCScene scene, RayHitPacket& rays) {
        RAYNEST_EMBREE_PACKET(rtcIntersect)(valid, scene, this, &rays);
    }
    void any(const int* valid, RTCScene scene, RayPacket& rays) {
        RAYNEST_EMBREE_PACKET(rtcOccluded)(valid, scene, this, &rays);
    }
};

inline constexpr RTCSceneFlags argument_filter_flag = RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION;
inline void take_argument_filter(RTCGeometry) {}

#endif

}  // namespace raynest::bench
