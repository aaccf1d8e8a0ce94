#include "server/diag/own_counts.h"

#include <algorithm>

namespace raynest::server {
namespace {

/// Principals that are remembered; the one that was idle for longest is forgotten first.
constexpr std::size_t principals_max = 1024;

}  // namespace

void OwnCounts::add(const std::string& principal, std::size_t counter, std::uint64_t count) {
    const std::lock_guard lock(mutex_);
    if (rows_.size() >= principals_max && !rows_.contains(principal)) {
        std::uint64_t oldest = clock_;
        for (const auto& [name, row] : rows_) oldest = std::min(oldest, row.last);
        std::erase_if(rows_, [&](const auto& row) { return row.second.last == oldest; });
    }
    Row& row = rows_[principal];
    row.counts[counter] += count;
    row.last = ++clock_;
}

std::uint64_t OwnCounts::of(const std::string& principal, std::size_t counter) const {
    const std::lock_guard lock(mutex_);
    const auto found = rows_.find(principal);
    return found == rows_.end() ? 0 : found->second.counts[counter];
}

}  // namespace raynest::server
