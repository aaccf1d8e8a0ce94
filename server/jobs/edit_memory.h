// Memory that an edit asks for while it is made.
#pragma once

#include "engine/scene/edits/edit_guard.h"
#include "server/ground/budget.h"

#include <algorithm>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>

namespace raynest::server {

/// Leases of one principal, which last as long as this. For one thread at a time.
class EditMemory {
public:
    /// `covered`: bytes of what is asked for that a lease of the caller has already.
    EditMemory(Budget& budget, std::string principal, Use use, std::uint64_t covered = 0)
        : budget_(budget),
          principal_(std::move(principal)),
          use_(use),
          covered_(covered) {}

    /// This must outlive the guard.
    [[nodiscard]] EditGuard guard(std::function<bool()> stopped) {
        return {[this](std::uint64_t bytes) { return reserve(bytes); }, std::move(stopped)};
    }

    /// The bytes that there was no room for; 0: there was room for all.
    [[nodiscard]] std::uint64_t refused() const { return refused_; }
    [[nodiscard]] Budget::Lease take() { return std::move(lease_); }

private:
    bool reserve(std::uint64_t bytes) {
        const std::uint64_t known = std::min(bytes, covered_);
        covered_ -= known;
        auto more = budget_.reserve(bytes - known, principal_, use_);
        if (!more) {
            refused_ = bytes - known;
            return false;
        }
        lease_.merge(std::move(*more));
        return true;
    }

    Budget& budget_;
    const std::string principal_;
    const Use use_;
    std::uint64_t covered_;
    std::uint64_t refused_ = 0;
    Budget::Lease lease_;
};

}  // namespace raynest::server
