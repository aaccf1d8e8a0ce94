#include "server/daemon/health.h"

#include "server/daemon/start_loads.h"
#include "server/net/descriptors.h"
#include "server/scheduling/fair_thread_pool.h"

#include <chrono>

namespace raynest::server {
namespace {

/// Time beyond chunk_ms_max after which the task of a compute thread counts as stuck.
constexpr std::chrono::milliseconds stuck_grace{5000};

}  // namespace

std::string unready_reason(const StartLoads& loads, FairThreadPool& compute,
                           const protocol::Limits& limits) {
    if (std::string loading = loads.unready(); !loading.empty()) return loading;
    if (std::string shortage = descriptors_fault(); !shortage.empty()) return shortage;
    const auto most = std::chrono::milliseconds(limits.chunk_ms_max) + stuck_grace;
    if (compute.longest_task() <= most) return {};
    return "a worker thread is stuck: its task has run for more than " +
           std::to_string(most.count()) + " ms";
}

}  // namespace raynest::server
