// The memory of an import child, counted towards --memory while it grows.
#pragma once

#include "server/ground/budget.h"

#include <atomic>
#include <cstdint>
#include <string>
#include <utility>

namespace raynest::server {

/// Reserves what a child holds, as often as it is measured. Used by the thread that waits for the
/// child, but for missing(), which any thread may call.
class ImportMemory {
public:
    /// `reclaimable`: bytes of requests that paused connections hold and that missing() asks for.
    ImportMemory(Budget& budget, std::string principal, Use use, std::uint64_t reclaimable = 0)
        : budget_(budget),
          principal_(std::move(principal)),
          use_(use),
          reclaimable_(reclaimable) {}
    ImportMemory(const ImportMemory&) = delete;

    /// Reserves `bytes` in all. False if they are more than the principal may take, even after
    /// paused connections have gone: end the child.
    [[nodiscard]] bool cover(std::uint64_t bytes) {
        if (bytes <= lease_.bytes()) return true;
        wanted_ = bytes;
        const std::uint64_t more = bytes - lease_.bytes();
        auto room = budget_.reserve(more, principal_, use_);
        if (room) lease_.merge(std::move(*room));
        missing_ = room ? 0 : more;
        refused_ = !room && more > budget_.room(principal_, use_, {.requests = reclaimable_});
        return !refused_;
    }
    /// True if cover() has failed.
    [[nodiscard]] bool refused() const { return refused_; }
    /// Refuses the import after that.
    [[nodiscard]] tl::unexpected<protocol::Error> refusal(const std::string& what,
                                                          const std::string& remedy) const {
        return budget_.refuse(what, wanted_, principal_, remedy);
    }
    /// Bytes that could not be reserved yet.
    [[nodiscard]] std::uint64_t missing() const { return missing_; }
    /// Most bytes of a scene that the child may build.
    [[nodiscard]] std::uint64_t room() const {
        return lease_.bytes() + budget_.room(principal_, use_, {.requests = reclaimable_});
    }
    /// Returns all but `bytes` to the budget, after the child has ended.
    void shrink(std::uint64_t bytes) {
        missing_ = 0;
        if (bytes < lease_.bytes()) lease_.shrink(bytes);
    }

private:
    Budget& budget_;
    const std::string principal_;
    const Use use_;
    const std::uint64_t reclaimable_;
    Budget::Lease lease_;
    std::uint64_t wanted_ = 0;
    bool refused_ = false;
    std::atomic<std::uint64_t> missing_{0};
};

}  // namespace raynest::server
