// The rays traced, by what they were traced for and by whom.
#pragma once

#include <compare>
#include <cstdint>
#include <map>
#include <mutex>
#include <string_view>
#include <vector>

namespace raynest::server {

/// Thread-safe. A chunk adds its rays at once, so the lock is taken a few hundred times a second.
class RayCounts {
public:
    /// The views must outlive this: they are names of intersectors, backends and kinds.
    struct Labels {
        std::string_view kind;
        std::string_view intersector;
        std::string_view backend;
        auto operator<=>(const Labels&) const = default;
    };
    struct Row {
        Labels labels;
        std::uint64_t rays;
    };

    void add(const Labels& labels, std::uint64_t rays) {
        const std::lock_guard lock(mutex_);
        rays_[labels] += rays;
    }
    [[nodiscard]] std::vector<Row> rows() const {
        const std::lock_guard lock(mutex_);
        std::vector<Row> rows;
        for (const auto& [labels, rays] : rays_) rows.push_back({labels, rays});
        return rows;
    }

private:
    mutable std::mutex mutex_;
    std::map<Labels, std::uint64_t> rays_;
};

}  // namespace raynest::server
