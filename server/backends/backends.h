// The backends of a daemon, and which of them may trace a job: a fixed rule (PROTOCOL.md,
// "Workers").
#pragma once

#include "server/backends/backend.h"

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

/// Material that backends are made from; outlives them.
struct BackendContext {
    const Options& options;
    const Registry& registry;
    Budget& budget;
    Metrics& metrics;
    const protocol::Limits& limits;
};

/// The one of this process: it takes every plan, and ends a chunk after chunk_ms_max.
std::unique_ptr<Backend> make_cpu(const BackendContext& context);
/// The first GPU of the system; without one, or without a pack for it, an absent one.
std::unique_ptr<Backend> make_cuda(const BackendContext& context);

/// In the order of `auto`: the CPU is last.
using Backends = std::vector<std::unique_ptr<Backend>>;

/// Those of THE LIST (backends.cpp).
[[nodiscard]] Backends make_backends(const BackendContext& context);

/// Which backends may trace a job.
struct BackendChoice {
    std::string asked = "auto";        ///< or the name of a backend
    std::vector<Backend*> order = {};  ///< the first one traces what it can, the next one the rest
    std::string reason = {};           ///< of auto: why the first one; empty without a choice

    [[nodiscard]] Backend& first() const { return *order.front(); }
};

/// Sets the backends of `plan`, which says what was asked, for a job of so many rays that also
/// traces by `others`. Fails on an unknown word, and where the request demands what cannot be.
Reply<void> choose_backends(const Backends& backends, std::uint64_t rays, Plan& plan,
                            std::span<const Plan* const> others = {});

/// As an error of a job that no other backend may trace.
[[nodiscard]] protocol::Error unavailable_error(const Backend& backend, const Unavailable& why);

}  // namespace raynest::server
