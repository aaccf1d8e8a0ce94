// The daemon's memory budget (--memory): scenes, uploads, imports and jobs reserve before they
// allocate.
//
// Principals share it by the rule of fair_share.h, in two uses:
//
//   lasting   scenes, what their loads need, and kept answers: all but the reserve
//   passing   requests under way: the reserve, and what is free besides
//
// So scenes fill the memory without stopping requests. What the daemon needs for itself, which its
// threads bound, has no principal and takes what is free.
#pragma once

#include "server/ground/errors.h"
#include "server/ground/fair_share.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

namespace raynest::server {

/// The purpose of a reservation.
enum class Use { lasting, passing };

/// Counts reserved bytes by principal. Thread-safe; must outlive its leases.
class Budget {
    using Bytes = std::array<std::uint64_t, 2>;     ///< by Use
    using Accounts = std::map<std::string, Bytes>;  ///< by principal, for those that hold some

public:
    /// A reservation; the destructor returns its bytes. Not thread-safe. Move-only.
    class Lease {
    public:
        Lease() = default;
        Lease(Lease&& other) noexcept
            : budget_(std::exchange(other.budget_, nullptr)),
              account_(other.account_),
              use_(other.use_),
              bytes_(std::exchange(other.bytes_, 0)) {}
        Lease& operator=(Lease&& other) noexcept {
            std::swap(budget_, other.budget_);
            std::swap(account_, other.account_);
            std::swap(use_, other.use_);
            std::swap(bytes_, other.bytes_);
            return *this;
        }
        Lease(const Lease&) = delete;
        ~Lease() { shrink(0); }

        [[nodiscard]] std::uint64_t bytes() const { return bytes_; }
        /// The principal that the bytes are charged to; there must be some.
        [[nodiscard]] const std::string& principal() const { return account_->first; }
        /// Adds another lease of the same principal and use to this one.
        void merge(Lease more);
        /// Returns all but `bytes` to the budget; `bytes` must not exceed bytes().
        void shrink(std::uint64_t bytes);
        /// Charges the bytes to another principal, whatever it holds. Throws std::bad_alloc.
        void charge(const std::string& principal);

    private:
        friend class Budget;
        Lease(Budget* budget, Accounts::iterator account, Use use, std::uint64_t bytes)
            : budget_(budget),
              account_(account),
              use_(use),
              bytes_(bytes) {}
        Budget* budget_ = nullptr;
        Accounts::iterator account_;  ///< valid while bytes_ is not 0
        Use use_ = Use::passing;
        std::uint64_t bytes_ = 0;
    };

    /// Memory that principals have and others are charged for, whom they know nothing of. Until this
    /// is destroyed, it counts in their room() as if they were charged for it, which would tell of
    /// the others otherwise. Move-only; assign only an empty one to one that is not.
    class Unpaid {
    public:
        using Bytes = std::map<std::string, std::uint64_t>;  ///< by principal
        Unpaid() = default;
        Unpaid(Unpaid&& other) noexcept
            : budget_(other.budget_),
              bytes_(std::exchange(other.bytes_, {})) {}
        Unpaid& operator=(Unpaid&& other) noexcept {
            std::swap(budget_, other.budget_);
            bytes_.swap(other.bytes_);
            return *this;
        }
        Unpaid(const Unpaid&) = delete;
        ~Unpaid();

        [[nodiscard]] const Bytes& bytes() const { return bytes_; }

    private:
        friend class Budget;
        Unpaid(Budget* budget, Bytes bytes) : budget_(budget), bytes_(std::move(bytes)) {}
        Budget* budget_ = nullptr;
        Bytes bytes_;
    };

    explicit Budget(std::uint64_t limit) : limit_(limit) {}
    Budget(const Budget&) = delete;

    /// Reserves bytes for a principal, or without one for the daemon; returns nothing if they are
    /// more than room(). Does not overflow for any `bytes`. Throws std::bad_alloc.
    [[nodiscard]] std::optional<Lease> reserve(std::uint64_t bytes,
                                               const std::string& principal = {},
                                               Use use = Use::passing);

    struct Freed {
        std::uint64_t requests = 0;  ///< passing bytes of others
        std::uint64_t lasting = 0;   ///< lasting bytes of anybody
        std::uint64_t own = 0;       ///< those that the principal is charged for no more
    };
    /// Returns how many bytes the principal may reserve once so much is freed.
    [[nodiscard]] std::uint64_t room(const std::string& principal, Use use,
                                     const Freed& freed) const;
    [[nodiscard]] std::uint64_t room(const std::string& principal, Use use) const {
        return room(principal, use, {});
    }

    /// Throws std::bad_alloc.
    [[nodiscard]] Unpaid count_unpaid(Unpaid::Bytes bytes);
    [[nodiscard]] std::uint64_t unpaid() const;

    [[nodiscard]] std::uint64_t limit() const { return limit_; }
    [[nodiscard]] std::uint64_t used() const;
    /// Bytes that are charged to a principal, for both uses. Of a scene that several hold one is
    /// charged, so this would tell a principal of others: SceneStore::memory_of() does not.
    [[nodiscard]] std::uint64_t held_by(const std::string& principal) const;

    /// Refuses what room() has no place for. `what` and its `bytes` begin the message, `remedy`
    /// ends it. It names no bytes that are held: held_by() says why.
    [[nodiscard]] tl::unexpected<protocol::Error> refuse(const std::string& what,
                                                         std::uint64_t bytes,
                                                         const std::string& principal,
                                                         const std::string& remedy) const;

    /// The part of --memory that is kept for requests.
    static constexpr std::uint64_t reserve_part = 8;

private:
    static std::uint64_t& of(Bytes& bytes, Use use) { return bytes[static_cast<std::size_t>(use)]; }
    // These require the lock.
    [[nodiscard]] std::uint64_t room_for(const std::string& principal,
                                         Accounts::const_iterator account, Use use,
                                         const Freed& freed) const;
    void give_back(Accounts::iterator account, Use use, std::uint64_t bytes);

    const std::uint64_t limit_;
    mutable std::mutex mutex_;
    Accounts accounts_;
    Unpaid::Bytes unpaid_;
    Bytes used_{};  ///< by all accounts
};

}  // namespace raynest::server
