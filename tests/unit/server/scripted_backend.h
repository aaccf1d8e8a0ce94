// A third backend, whole: kernels of the CPU behind threads of its own, which refuse, come late and
// die as a test says. It takes this file, and one line: put_first().
#pragma once

#include "server/backends/backends.h"
#include "server/execution/plan.h"
#include "server/scheduling/fair_thread_pool.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace raynest::server {

class ScriptedBackend final : public Backend {
public:
    enum class Does { answers, refuses, comes_late, dies };
    /// `script` returns what a call does, given its number from 0 on. Without threads the backend
    /// traces on the thread of the calling task.
    ScriptedBackend(std::uint64_t call_rays, unsigned threads,
                    std::function<Does(std::uint64_t call)> script)
        : call_rays_(call_rays),
          script_(std::move(script)) {
        if (threads != 0) pool_.emplace(threads, FairThreadPool::Time::clock);
    }

    [[nodiscard]] std::string_view name() const override { return "scripted"; }
    [[nodiscard]] std::string title() const override { return "the scripted worker"; }
    [[nodiscard]] std::string target(const Plan& plan) const override {
        return plan.variant->target;
    }
    /// It starts between the first question and the second.
    [[nodiscard]] std::vector<std::string> kernels() override {
        if (asked_++ == 0) return {};
        return {"opaque", "alpha_mask"};
    }
    [[nodiscard]] std::optional<Unavailable> unavailable_reason(const Plan& /*plan*/) override {
        return dead_ ? std::optional(died()) : std::nullopt;
    }
    [[nodiscard]] std::uint64_t call_rays_max(const Plan& /*plan*/) const override {
        return call_rays_;
    }
    [[nodiscard]] FairThreadPool* pool() override { return pool_ ? &*pool_ : nullptr; }
    Traced<Traversal> trace(const Plan& plan, const TraceCall& call, const PinholeRays* /*camera*/,
                            const Stop& /*stop*/) override {
        switch (script_(calls_++)) {
            case Does::answers:
                break;
            case Does::refuses:
                return tl::unexpected(TraceFailure(Unavailable{"it does not like these rays"}));
            case Does::comes_late:
                std::this_thread::sleep_for(std::chrono::milliseconds(10));
                break;
            case Does::dies:
                dead_ = true;
                break;
        }
        const Traversal traversal = plan.selector.choose({call.rays, call.ray_count}, *call.scene);
        plan.selector.function(traversal)(&call);
        // It dies with its answers half written.
        if (dead_) return tl::unexpected(TraceFailure(died()));
        ++answered;
        return traversal;
    }

    std::atomic<std::uint64_t> answered{0};  ///< calls

private:
    [[nodiscard]] static Unavailable died() { return {"it died", Code::busy, 1000}; }

    const std::uint64_t call_rays_;
    const std::function<Does(std::uint64_t)> script_;
    std::atomic<std::uint64_t> asked_{0}, calls_{0};
    std::atomic<bool> dead_{false};
    std::optional<FairThreadPool> pool_;
};

inline void put_first(Backends& backends, std::unique_ptr<Backend> backend) {
    backends.push_back(std::move(backend));
    std::rotate(backends.begin(), backends.end() - 1, backends.end());
}

}  // namespace raynest::server
