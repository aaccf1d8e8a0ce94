// Indices of long lists in a scene, so that a request need not look at all of one.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>

namespace raynest {

/// An index for each of some long lists, made when it is first asked for. Thread-safe.
template <class Index>
class LongLists {
public:
    /// Shorter lists are read as fast.
    static constexpr std::uint32_t steps_min = 64;

    /// Returns the index of the list below a parent; make() makes it, under a lock.
    template <class Make>
    std::shared_ptr<const Index> of(std::uint32_t parent, const Make& make) {
        const std::scoped_lock lock(mutex_);
        auto& index = by_parent_[parent];
        if (!index) index = std::make_shared<const Index>(make());
        return index;
    }
    /// How many have been made.
    [[nodiscard]] std::size_t made() const {
        const std::scoped_lock lock(mutex_);
        return by_parent_.size();
    }

private:
    mutable std::mutex mutex_;
    std::map<std::uint32_t, std::shared_ptr<const Index>> by_parent_;
};

}  // namespace raynest
