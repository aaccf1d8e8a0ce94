#include "server/ground/own_counts.h"

#include <algorithm>
#include <functional>
#include <utility>

namespace raynest::server {
namespace {

/// Principals that are remembered; the one that was idle for longest is forgotten first.
constexpr std::size_t principals_max = 1024;

}  // namespace

void OwnCounts::add(const std::string& principal, std::size_t counter, std::uint64_t count) {
    // Strangers with many addresses must not push out what is remembered of clients.
    if (principal.empty()) return;
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

std::vector<std::string> OwnCounts::latest(std::size_t most) const {
    std::vector<std::pair<std::uint64_t, std::string>> found;
    {
        const std::lock_guard lock(mutex_);
        for (const auto& [principal, row] : rows_) found.emplace_back(row.last, principal);
    }
    std::ranges::sort(found, std::greater());
    found.resize(std::min(found.size(), most));
    std::vector<std::string> principals;
    for (auto& [last, principal] : found) principals.push_back(std::move(principal));
    return principals;
}

}  // namespace raynest::server
