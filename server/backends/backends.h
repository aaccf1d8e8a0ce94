// The daemon's backends, and the rule that chooses those of a job (PROTOCOL.md, "Workers").
#pragma once

#include "server/execution/backend.h"

#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest {
class Registry;
}

namespace raynest::server {

class Budget;
struct Metrics;
struct Options;

/// References that backends are constructed with; their targets outlive the backends.
struct BackendContext {
    const Options& options;
    const Registry& registry;
    Budget& budget;
    Metrics& metrics;
    const protocol::Limits& limits;
};

/// Functions that make a backend, one for each row of workers.def:
/// - make_cpu: the backend of this process. It accepts every plan and stops chunks after
///   chunk_ms_max.
/// - make_cuda: the backend of the system's first GPU. Without a kernel pack for it, the backend
///   refuses every plan as absent.
#define RAYNEST_WORKER(name, text) \
    std::unique_ptr<Backend> make_##name(const BackendContext& context);
#include "protocol/workers.def"

/// Backends in the order in which `auto` tries them; the CPU is last.
using Backends = std::vector<std::unique_ptr<Backend>>;

/// Makes all backends of workers.def.
[[nodiscard]] Backends make_backends(const BackendContext& context);

/// The backends that may trace a job.
struct BackendChoice {
    std::string asked = "auto";        ///< "auto" or the name of a backend
    std::vector<Backend*> order = {};  ///< chunks that one backend gives up go to the next one
    std::string reason = {};           ///< why `auto` put the first one first; else empty

    [[nodiscard]] Backend& first() const { return *order.front(); }
};

/// Sets plan.worker for a job of `rays` rays from plan.worker.asked. A backend is chosen only if it
/// also accepts the plans in `others`. Fails if the requested backend is unknown or unavailable.
Reply<void> choose_backends(const Backends& backends, std::uint64_t rays, Plan& plan,
                            std::span<const Plan* const> others = {});

/// Returns the error of a job that no other backend may trace.
[[nodiscard]] protocol::Error unavailable_error(const Backend& backend, const Unavailable& why);

}  // namespace raynest::server
