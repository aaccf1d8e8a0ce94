// A backend traces the chunks of jobs: the CPU, a GPU, later other hosts.
//
//   Plan, rays ──► Backend::trace ──► hits | "try elsewhere, because ..." | the job's error
//
// A new backend is one file that implements this interface, and one line in backends.cpp.
#pragma once

#include "engine/geometry/pinhole.h"
#include "engine/packs/abi.h"
#include "server/errors.h"
#include "server/jobs/job.h"

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>

namespace raynest::server {

class FairThreadPool;
struct Plan;

/// Why a backend cannot trace something that another backend can.
struct Unavailable {
    std::string reason;
    Code code = Code::unsupported;  ///< for a client that allows no other backend
    std::uint32_t retry_after_ms = 0;
    bool lost = false;    ///< the process behind it is no good any more
    bool absent = false;  ///< this daemon has no such backend at all
};

/// Why a chunk has no hits: another backend should trace it, or its job fails.
using TraceFailure = std::variant<Unavailable, protocol::Error>;
template <class T>
using Traced = tl::expected<T, TraceFailure>;

/// Thread-safe. Outlives all jobs.
class Backend {
public:
    Backend() = default;
    Backend(const Backend&) = delete;
    Backend& operator=(const Backend&) = delete;
    virtual ~Backend() = default;

    /// The word of a request's `worker`.
    [[nodiscard]] virtual std::string_view name() const = 0;
    /// Its name in a sentence.
    [[nodiscard]] virtual std::string title() const = 0;
    /// The target that its kernels for this plan are compiled for.
    [[nodiscard]] virtual std::string target(const Plan& plan) const = 0;
    /// Has it kernels of this intersector, beside those of the CPU?
    [[nodiscard]] virtual bool has_kernels(std::string_view /*intersector*/) { return false; }

    /// Nothing where it takes the plan's chunks now.
    [[nodiscard]] virtual std::optional<Unavailable> unavailable_reason(const Plan& plan) = 0;
    /// `auto` sends jobs of fewer rays elsewhere: the way there and back is not worth while.
    [[nodiscard]] virtual std::uint64_t job_rays_min() const { return 0; }
    /// Rays of a call at most.
    [[nodiscard]] virtual std::uint64_t call_rays_max(const Plan& plan) const = 0;
    /// Threads that wait for its calls. Null: it traces on the daemon's compute threads, and small
    /// requests at once or several together.
    [[nodiscard]] virtual FairThreadPool* pool() { return nullptr; }
    /// Does it make the rays of a pinhole camera itself? Then those of a call need not exist.
    [[nodiscard]] virtual bool makes_camera_rays() const { return false; }

    /// Blocking: fills in the hits of `call`, and what else it points to. `camera`, where there is
    /// one, makes the rays of the call. Gives the traversal that was used.
    /// CANCELLED where `stop` is requested meanwhile.
    virtual Traced<Traversal> trace(const Plan& plan, const TraceCall& call,
                                    const PinholeRays* camera, const Stop& stop) = 0;
};

}  // namespace raynest::server
