#include "tests/bench/embree/forms.h"

#include "tests/bench/embree/filters.h"

#include <algorithm>
#include <utility>

namespace raynest::bench {
namespace {

void fill(RTCRay& to, const Ray& ray) {
    to.org_x = ray.origin.x;
    to.org_y = ray.origin.y;
    to.org_z = ray.origin.z;
    to.tnear = ray.tmin;
    to.dir_x = ray.direction.x;
    to.dir_y = ray.direction.y;
    to.dir_z = ray.direction.z;
    to.tfar = ray.tmax;
    to.time = 0;
    to.mask = 0xFFFFFFFFU;
    to.id = 0;
    to.flags = 0;
}

void fill(RayPacket& to, const Ray* rays, std::uint32_t count) {
    for (std::uint32_t i = 0; i < count; ++i) {
        to.org_x[i] = rays[i].origin.x;
        to.org_y[i] = rays[i].origin.y;
        to.org_z[i] = rays[i].origin.z;
        to.tnear[i] = rays[i].tmin;
        to.dir_x[i] = rays[i].direction.x;
        to.dir_y[i] = rays[i].direction.y;
        to.dir_z[i] = rays[i].direction.z;
        to.tfar[i] = rays[i].tmax;
    }
    std::fill_n(to.time, packet_rays, 0.0F);
    std::fill_n(to.mask, packet_rays, 0xFFFFFFFFU);
    std::fill_n(to.flags, packet_rays, 0U);
}

HitRecord record_of(const RTCRayHit& query) {
    HitRecord record;
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return record;
    record.t = query.ray.tfar;
    record.u = query.hit.u;
    record.v = query.hit.v;
    record.triangle = query.hit.primID;
    record.object = query.hit.geomID;
    record.path = query.hit.instID[0];
    record.hit = 1;
    return record;
}

HitRecord record_of(const RayHitPacket& query, std::uint32_t i) {
    HitRecord record;
    if (query.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID) return record;
    record.t = query.ray.tfar[i];
    record.u = query.hit.u[i];
    record.v = query.hit.v[i];
    record.triangle = query.hit.primID[i];
    record.object = query.hit.geomID[i];
    record.path = query.hit.instID[0][i];
    record.hit = 1;
    return record;
}

HitRecord occluded(float tfar) {
    HitRecord record;
    record.hit = tfar < 0 ? 1 : 0;
    return record;
}

void closest_single(RTCScene scene, RTCFilterFunctionN filter, const PeerCall& call) {
    Asker asker(false, filter);
    for (std::uint32_t i = 0; i < call.ray_count; ++i) {
        RTCRayHit query;
        fill(query.ray, call.rays[i]);
        query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
        asker.closest(scene, query);
        call.hits[i] = record_of(query);
    }
}

void any_single(RTCScene scene, RTCFilterFunctionN filter, const PeerCall& call) {
    Asker asker(false, filter);
    for (std::uint32_t i = 0; i < call.ray_count; ++i) {
        RTCRay query;
        fill(query, call.rays[i]);
        asker.any(scene, query);
        call.hits[i] = occluded(query.tfar);
    }
}

/// Calls `ask(first, count, valid)` for each packet; lanes of the last one that hold no ray are not
/// valid.
template <class Ask>
void for_packets(std::uint32_t ray_count, Ask ask) {
    for (std::uint32_t first = 0; first < ray_count; first += packet_rays) {
        const std::uint32_t count = std::min(packet_rays, ray_count - first);
        alignas(64) int valid[packet_rays] = {};
        std::fill_n(valid, count, -1);
        ask(first, count, valid);
    }
}

void closest_packets(RTCScene scene, bool coherent, const PeerCall& call) {
    Asker asker(coherent, nullptr);
    for_packets(call.ray_count, [&](std::uint32_t first, std::uint32_t count, const int* valid) {
        RayHitPacket query;
        fill(query.ray, call.rays + first, count);
        std::fill_n(query.hit.geomID, packet_rays, RTC_INVALID_GEOMETRY_ID);
        std::fill_n(query.hit.instID[0], packet_rays, RTC_INVALID_GEOMETRY_ID);
        asker.closest(valid, scene, query);
        for (std::uint32_t i = 0; i < count; ++i) call.hits[first + i] = record_of(query, i);
    });
}

void any_packets(RTCScene scene, bool coherent, const PeerCall& call) {
    Asker asker(coherent, nullptr);
    for_packets(call.ray_count, [&](std::uint32_t first, std::uint32_t count, const int* valid) {
        RayPacket query;
        fill(query, call.rays + first, count);
        asker.any(valid, scene, query);
        for (std::uint32_t i = 0; i < count; ++i) call.hits[first + i] = occluded(query.tfar[i]);
    });
}

void list_single(RTCScene scene, const PeerCall& call) {
    ListAsker asker(false, nullptr);
    asker.capacity = call.hits_max;
    for (std::uint32_t i = 0; i < call.ray_count; ++i) {
        RTCRayHit query;
        fill(query.ray, call.rays[i]);
        query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
        asker.nearest = call.hits + std::size_t{i} * call.hits_max;
        asker.count = 0;
        asker.closest(scene, query);
        call.hit_counts[i] = asker.count;
    }
}

/// Lane count of a form, its scene and its filter.
struct Plan {
    PeerForm form;
    TreeForm tree;
    bool coherent;
};

const std::vector<Plan>& plans() {
    static const std::vector<Plan> all = [] {
        const std::vector<Query> both{query_closest, query_any};
        TreeForm robust;
        robust.robust = true;
        TreeForm filter;
        filter.filter = filter_alpha;
        TreeForm argument = filter;
        argument.filter_in_query = true;
        TreeForm list;
        list.filter = filter_list_all;
        list.filter_all = true;
        TreeForm shrink = list;
        shrink.filter = filter_list_shrink;
        return std::vector<Plan>{
            {{"embree", false, 1, both}, {}, false},
            {{"embree-packet", false, packet_rays, both}, {}, false},
            {{"embree-coherent", false, packet_rays, both}, {}, true},
            {{"embree-robust", false, 1, both}, robust, false},
            {{"embree-filter", true, 1, both}, filter, false},
            {{"embree-filter-coherent", true, packet_rays, both}, filter, true},
            {{"embree-argument", true, 1, both}, argument, false},
            {{"embree-list", false, 1, {query_multi}}, list, false},
            {{"embree-shrink", false, 1, {query_multi}}, shrink, false}};
    }();
    return all;
}

class EmbreePeer final : public Peer {
public:
    EmbreePeer(std::shared_ptr<const EmbreeTree> tree, const Plan& plan, Query query)
        : tree_(std::move(tree)),
          plan_(plan),
          query_(query) {}

    void trace(const PeerCall& call) const override {
        const RTCScene scene = tree_->root();
        const RTCFilterFunctionN filter = plan_.tree.filter_in_query ? plan_.tree.filter : nullptr;
        if (query_ == query_multi) {
            list_single(scene, call);
        } else if (plan_.form.width > 1) {
            query_ == query_any ? any_packets(scene, plan_.coherent, call)
                                : closest_packets(scene, plan_.coherent, call);
        } else {
            query_ == query_any ? any_single(scene, filter, call)
                                : closest_single(scene, filter, call);
        }
    }

    void translate(std::span<HitRecord> hits) const override {
        if (query_ != query_any) tree_->translate(hits);
    }

private:
    std::shared_ptr<const EmbreeTree> tree_;
    const Plan& plan_;
    Query query_;
};

}  // namespace

std::span<const PeerForm> embree_forms() {
    static const std::vector<PeerForm> forms = [] {
        std::vector<PeerForm> all;
        for (const Plan& plan : plans()) all.push_back(plan.form);
        return all;
    }();
    return forms;
}

Result<std::unique_ptr<Peer>> open_embree(EmbreeTrees& trees, const PeerForm& form, Query query,
                                          const SceneView& view) {
    const auto plan = std::find_if(plans().begin(), plans().end(), [&](const Plan& candidate) {
        return candidate.form.name == form.name;
    });
    for (const EmbreeTrees::Entry& entry : trees.entries) {
        if (entry.view == &view && entry.form == plan->tree) {
            return std::make_unique<EmbreePeer>(entry.tree, *plan, query);
        }
    }
    auto tree = EmbreeTree::make(view, plan->tree, 1);
    if (!tree) return tl::unexpected(tree.error());
    (*tree)->commit();
    trees.entries.push_back({&view, plan->tree, std::move(*tree)});
    return std::make_unique<EmbreePeer>(trees.entries.back().tree, *plan, query);
}

}  // namespace raynest::bench
