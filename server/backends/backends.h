// The list of backends.
#pragma once

#include "protocol/limits.h"
#include "server/execution/backend.h"

#include <memory>
#include <string>

namespace raynest {
class Registry;
}

namespace raynest::server {

class Budget;
struct Metrics;

/// References that backends are constructed with; their targets outlive the backends.
struct BackendContext {
    std::string cuda_pack;  ///< as --cuda-pack has it
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
#include "protocol/lists/workers.def"

/// Makes all backends of workers.def.
[[nodiscard]] Backends make_backends(const BackendContext& context);

}  // namespace raynest::server
