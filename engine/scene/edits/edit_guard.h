// Memory and time that an edit may take. All that a request can make large asks
// first, so that no edit takes what nobody counted, or goes on for nobody.
#pragma once

#include "engine/result.h"

#include <cstdint>
#include <functional>

namespace raynest {

/// Used on the thread that edits. Without functions all is allowed.
struct EditGuard {
    /// Called before memory is allocated, several times; false: there is no room.
    std::function<bool(std::uint64_t bytes)> reserve = {};
    /// True once nobody waits for the edit any more.
    std::function<bool()> stopped = {};

    [[nodiscard]] bool is_stopped() const { return stopped && stopped(); }

    /// Fails with out_of_memory if there is no room for the bytes, or nobody waits: whoever gave
    /// the functions knows which.
    [[nodiscard]] Result<void> allows(std::uint64_t bytes) const {
        if (is_stopped()) return fail(ErrorCode::out_of_memory, "the edit was stopped");
        if (bytes != 0 && reserve && !reserve(bytes))
            return fail(ErrorCode::out_of_memory, "there is no memory for the changed scene");
        return {};
    }
};

}  // namespace raynest
