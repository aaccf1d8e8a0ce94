// The daemon's memory budget (--memory): scenes, uploads and jobs reserve before they allocate.
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>
#include <utility>

namespace raynest::server {

/// Counts reserved bytes. Thread-safe; must outlive its leases.
class Budget {
public:
    /// A reservation; the destructor returns its bytes. Not thread-safe. Move-only.
    class Lease {
    public:
        Lease() = default;
        Lease(Lease&& other) noexcept
            : budget_(std::exchange(other.budget_, nullptr)),
              bytes_(other.bytes_) {}
        Lease& operator=(Lease&& other) noexcept {
            std::swap(budget_, other.budget_);
            std::swap(bytes_, other.bytes_);
            return *this;
        }
        Lease(const Lease&) = delete;
        ~Lease() {
            if (budget_ != nullptr) budget_->used_ -= bytes_;
        }

        [[nodiscard]] std::uint64_t bytes() const { return bytes_; }
        /// Adds another lease of the same budget to this one.
        void merge(Lease more) {
            if (budget_ == nullptr) budget_ = more.budget_;
            bytes_ += std::exchange(more.bytes_, 0);
        }
        /// Returns all but `bytes` to the budget; `bytes` must not exceed bytes().
        void shrink(std::uint64_t bytes) {
            if (budget_ != nullptr) budget_->used_ -= bytes_ - bytes;
            bytes_ = bytes;
        }

    private:
        friend class Budget;
        Lease(Budget* budget, std::uint64_t bytes) : budget_(budget), bytes_(bytes) {}
        Budget* budget_ = nullptr;
        std::uint64_t bytes_ = 0;
    };

    explicit Budget(std::uint64_t limit) : limit_(limit) {}
    Budget(const Budget&) = delete;

    /// Reserves bytes; returns nothing if fewer are left. Does not overflow for any `bytes`.
    [[nodiscard]] std::optional<Lease> reserve(std::uint64_t bytes) {
        std::uint64_t used = used_.load();
        do {
            if (bytes > limit_ - used) return std::nullopt;
        } while (!used_.compare_exchange_weak(used, used + bytes));
        return Lease(this, bytes);
    }

    [[nodiscard]] std::uint64_t limit() const { return limit_; }
    [[nodiscard]] std::uint64_t used() const { return used_.load(); }

private:
    const std::uint64_t limit_;
    std::atomic<std::uint64_t> used_{0};
};

}  // namespace raynest::server
