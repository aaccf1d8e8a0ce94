#include "server/backends/backends.h"

namespace raynest::server {
Backends make_backends(const BackendContext& context) {
    Backends backends;
#define RAYNEST_WORKER(name, text) backends.push_back(make_##name(context));
#include "protocol/lists/workers.def"
    return backends;
}

}  // namespace raynest::server
