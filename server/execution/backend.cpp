#include "server/execution/backend.h"

namespace raynest::server {

protocol::Error unavailable_error(const Backend& backend, const Unavailable& why) {
    return {why.code, backend.title() + ": " + why.reason + "; use auto or cpu as `worker`",
            why.retry_after_ms};
}

}  // namespace raynest::server
