#include "server/requests/quota_use.h"

#include "server/scheduling/admission.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"

namespace raynest::server {

std::array<QuotaUse, 6> quota_uses(const Services& services, const std::string& principal) {
    const Quota quota = services.admission.quotas().of(principal);
    std::uint64_t rays = 0;
    for (const auto& [number, job] : services.admission.jobs())
        if (job.principal == principal) rays += job.rays;
    const auto listed = services.scenes.charged_to(principal, true);
    const auto unlisted = services.scenes.charged_to(principal, false);
    return {{{"connections", services.peers.size_of(principal), quota.connections},
             {"jobs", services.admission.active_of(principal), quota.jobs},
             {"rays", rays, quota.rays},
             {"scenes", listed.scenes + unlisted.scenes, services.limits.principal_scenes_max},
             {"scene_bytes", listed.bytes + unlisted.bytes, quota.scene_bytes},
             {"disk_bytes", services.scenes.on_disk_of(principal), quota.disk_bytes}}};
}

}  // namespace raynest::server
