// The interface of backends. A backend traces the chunks of jobs: on the CPU, on a GPU.
//
//   Plan, rays ──► Backend::trace ──► hits | "try elsewhere, because ..." | the job's error
//
// A new backend is one file that implements this interface, and one line in protocol/lists/workers.def.
#pragma once

#include "engine/geometry/pinhole.h"
#include "engine/packs/abi.h"
#include "server/ground/errors.h"
#include "server/ground/stop.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace raynest::server {

class FairThreadPool;
struct Plan;

/// The reason why a backend cannot trace something that another backend can.
struct Unavailable {
    std::string reason;
    Code code = Code::unsupported;  ///< error code if the request allows no other backend
    std::uint32_t retry_after_ms = 0;
    bool lost = false;    ///< the backend's process failed and must be replaced
    bool absent = false;  ///< this daemon has no such backend at all
};

/// The reason why a chunk has no hits: another backend should trace it, or its job fails.
using TraceFailure = std::variant<Unavailable, protocol::Error>;
template <class T>
using Traced = tl::expected<T, TraceFailure>;

/// Traces chunks. Thread-safe; outlives all jobs.
class Backend {
public:
    Backend() = default;
    Backend(const Backend&) = delete;
    Backend& operator=(const Backend&) = delete;
    virtual ~Backend() = default;

    /// The name by which a request's `worker` chooses this backend.
    [[nodiscard]] virtual std::string_view name() const = 0;
    /// The name in error messages, e.g. "the CPU".
    [[nodiscard]] virtual std::string title() const = 0;
    /// Returns the target that the kernels for this plan are compiled for.
    [[nodiscard]] virtual std::string target(const Plan& plan) const = 0;
    /// Names the intersectors that it has kernels of its own for at one moment; none for the CPU.
    [[nodiscard]] virtual std::vector<std::string> kernels() { return {}; }

    /// Returns nothing if the backend accepts the plan's chunks at this moment.
    [[nodiscard]] virtual std::optional<Unavailable> unavailable_reason(const Plan& plan) = 0;
    /// Number of rays below which `auto` sends a job elsewhere, because transfers would cost more
    /// than they gain.
    [[nodiscard]] virtual std::uint64_t job_rays_min() const { return 0; }
    /// Maximum number of rays per call of trace().
    [[nodiscard]] virtual std::uint64_t call_rays_max(const Plan& plan) const = 0;
    /// Threads that block in trace(). Null: chunks run on the daemon's compute threads, where small
    /// requests may run inline or be coalesced.
    [[nodiscard]] virtual FairThreadPool* pool() { return nullptr; }
    /// True if trace() generates pinhole camera rays itself; the call's rays are then not read.
    [[nodiscard]] virtual bool makes_camera_rays() const { return false; }

    /// Fills in the hits of `call` and its other output buffers. Blocking. `camera`, if not null,
    /// generates the call's rays. Returns the traversal used, or CANCELLED if `stop` was requested.
    virtual Traced<Traversal> trace(const Plan& plan, const TraceCall& call,
                                    const PinholeRays* camera, const Stop& stop) = 0;
};

/// Backends in the order in which `auto` tries them; the CPU is last.
using Backends = std::vector<std::unique_ptr<Backend>>;

/// The backends that may trace a job.
struct BackendChoice {
    std::string asked = "auto";        ///< "auto" or the name of a backend
    std::vector<Backend*> order = {};  ///< chunks that one backend gives up go to the next one
    std::string reason = {};           ///< why `auto` put the first one first; else empty

    [[nodiscard]] Backend& first() const { return *order.front(); }
};

/// Returns the error of a job that no other backend may trace.
[[nodiscard]] protocol::Error unavailable_error(const Backend& backend, const Unavailable& why);

}  // namespace raynest::server
