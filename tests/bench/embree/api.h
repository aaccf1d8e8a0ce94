// Embree 3 and 4 behind one small set of names: they differ in how a query carries its filter and
// its flags.
#pragma once

#if RAYNEST_EMBREE == 4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

namespace raynest::bench {

inline constexpr const char* device_options =
    "set_affinity=0,frequency_level=simd512,hugepages=1,threads=";

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
    void closest(const int* valid, RTCScene scene, RTCRayHit16& rays) {
        rtcIntersect16(valid, scene, &rays, &intersect_);
    }
    void any(const int* valid, RTCScene scene, RTCRay16& rays) {
        rtcOccluded16(valid, scene, &rays, &occluded_);
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
    void closest(const int* valid, RTCScene scene, RTCRayHit16& rays) {
        rtcIntersect16(valid, scene, this, &rays);
    }
    void any(const int* valid, RTCScene scene, RTCRay16& rays) {
        rtcOccluded16(valid, scene, this, &rays);
    }
};

inline constexpr RTCSceneFlags argument_filter_flag = RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION;
inline void take_argument_filter(RTCGeometry) {}

#endif

}  // namespace raynest::bench
