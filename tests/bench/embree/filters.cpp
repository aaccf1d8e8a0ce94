#include "tests/bench/embree/filters.h"

#include "engine/intersectors/texture.h"
#include "tests/bench/embree/tree.h"

namespace raynest::bench {
namespace {

/// Inserts the candidate of a single ray; returns the list's owner.
ListAsker& insert(const RTCFilterFunctionNArguments* call) {
    ListAsker& list = *static_cast<ListAsker*>(call->context);
    const auto& hit = *reinterpret_cast<const RTCHit*>(call->hit);
    const float t = reinterpret_cast<const RTCRay*>(call->ray)->tfar;
    std::uint32_t at = list.count;
    if (at == list.capacity) {
        if (t >= list.nearest[at - 1].t) return list;
        --at;
    } else {
        ++list.count;
    }
    for (; at > 0 && t < list.nearest[at - 1].t; --at) list.nearest[at] = list.nearest[at - 1];
    HitRecord& record = list.nearest[at];
    record = HitRecord{};
    record.t = t;
    record.u = hit.u;
    record.v = hit.v;
    record.triangle = hit.primID;
    record.object = hit.geomID;
    record.path = hit.instID[0];
    record.hit = 1;
    return list;
}

}  // namespace

void filter_alpha(const RTCFilterFunctionNArguments* call) {
    const auto& masked = *static_cast<const MaskedGeometry*>(call->geometryUserPtr);
    const MaterialRecord& material = *masked.material;
    const float least = material.alpha_mode == AlphaMode::blend ? 0.5F : material.cutoff;
    for (unsigned i = 0; i < call->N; ++i) {
        if (call->valid[i] == 0) continue;
        const float alpha =
            surface_alpha(*masked.scene, *masked.geometry, material,
                          masked.geometry->first_triangle + RTCHitN_primID(call->hit, call->N, i),
                          RTCHitN_u(call->hit, call->N, i), RTCHitN_v(call->hit, call->N, i));
        if (alpha < least) call->valid[i] = 0;
    }
}

void filter_list_all(const RTCFilterFunctionNArguments* call) {
    insert(call);
    call->valid[0] = 0;
}

void filter_list_shrink(const RTCFilterFunctionNArguments* call) {
    const ListAsker& list = insert(call);
    if (list.count < list.capacity) {
        call->valid[0] = 0;
    } else {
        reinterpret_cast<RTCRay*>(call->ray)->tfar = list.nearest[list.count - 1].t;
    }
}

}  // namespace raynest::bench
