#include "server/requests/quota_use.h"

#include "server/scheduling/admission.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"

namespace raynest::server {

std::map<std::string, QuotaUses> quota_uses(const Services& services,
                                            const std::vector<std::string>& principals) {
    std::map<std::string, std::uint64_t> rays;
    for (const auto& [number, job] : services.admission.jobs()) rays[job.principal] += job.rays;
    std::map<std::string, QuotaUses> all;
    for (const auto& [principal, scenes] : services.scenes.usage_of(principals)) {
        const Quota quota = services.admission.quotas().of(principal);
        const auto rays_of = rays.find(principal);
        all[principal] = {{{"connections", services.peers.size_of(principal), quota.connections},
                           {"jobs", services.admission.active_of(principal), quota.jobs},
                           {"rays", rays_of == rays.end() ? 0 : rays_of->second, quota.rays},
                           {"scenes", scenes.scenes, services.limits.principal_scenes_max},
                           {"scene_bytes", scenes.bytes, quota.scene_bytes},
                           {"disk_bytes", scenes.disk_bytes, quota.disk_bytes}}};
    }
    return all;
}

QuotaUses quota_uses(const Services& services, const std::string& principal) {
    return quota_uses(services, std::vector{principal}).at(principal);
}

}  // namespace raynest::server
