#include "server/ground/budget.h"

#include "protocol/text.h"

#include <algorithm>

namespace raynest::server {

void Budget::Lease::merge(Lease more) {
    if (more.bytes_ == 0) return;
    if (bytes_ == 0) {
        budget_ = more.budget_;
        account_ = more.account_;
        use_ = more.use_;
    }
    bytes_ += std::exchange(more.bytes_, 0);
}

void Budget::Lease::shrink(std::uint64_t bytes) {
    if (bytes == bytes_) return;
    const std::lock_guard lock(budget_->mutex_);
    const std::uint64_t held = std::exchange(bytes_, bytes);
    budget_->give_back(account_, use_, held - bytes);
}

void Budget::Lease::charge(const std::string& principal) {
    if (bytes_ == 0 || account_->first == principal) return;
    const std::lock_guard lock(budget_->mutex_);
    const auto next = budget_->accounts_.try_emplace(principal).first;
    of(next->second, use_) += bytes_;
    of(budget_->used_, use_) += bytes_;
    budget_->give_back(std::exchange(account_, next), use_, bytes_);
}

std::optional<Budget::Lease> Budget::reserve(std::uint64_t bytes, const std::string& principal,
                                             Use use) {
    if (bytes == 0) return Lease();
    const std::lock_guard lock(mutex_);
    auto account = accounts_.find(principal);
    if (bytes > room_for(principal, account, use, {})) return std::nullopt;
    if (account == accounts_.end()) account = accounts_.try_emplace(principal).first;
    of(account->second, use) += bytes;
    of(used_, use) += bytes;
    return Lease(this, account, use, bytes);
}

void Budget::give_back(Accounts::iterator account, Use use, std::uint64_t bytes) {
    of(used_, use) -= bytes;
    of(account->second, use) -= bytes;
    if (account->second == Bytes{}) accounts_.erase(account);
}

std::uint64_t Budget::room(const std::string& principal, Use use, const Freed& freed) const {
    const std::lock_guard lock(mutex_);
    return room_for(principal, accounts_.find(principal), use, freed);
}

std::uint64_t Budget::room_for(const std::string& principal, Accounts::const_iterator account,
                               Use use, const Freed& freed) const {
    const auto part = [use](const Bytes& bytes) { return bytes[static_cast<std::size_t>(use)]; };
    const auto less = [](std::uint64_t bytes, std::uint64_t gone) {
        return bytes - std::min(bytes, gone);
    };
    const std::uint64_t lasting =
        less(used_[static_cast<std::size_t>(Use::lasting)], freed.lasting);
    const std::uint64_t passing =
        less(used_[static_cast<std::size_t>(Use::passing)], freed.requests);
    std::uint64_t free = limit_ - lasting - passing;
    if (principal.empty()) return free;
    const auto others_pay = unpaid_.find(principal);
    const std::uint64_t unpaid = others_pay == unpaid_.end() ? 0 : others_pay->second;
    free -= std::min(free, unpaid);
    // Requests use the reserve first.
    const std::uint64_t reserve = limit_ / reserve_part;
    const std::uint64_t kept = use == Use::lasting ? reserve - std::min(reserve, passing) : 0;
    const std::uint64_t charged = account == accounts_.end() ? 0 : part(account->second);
    const std::uint64_t held = use == Use::lasting ? less(charged, freed.own) + unpaid : charged;
    return fair_part(held, free - std::min(free, kept));
}

Budget::Unpaid Budget::count_unpaid(Unpaid::Bytes bytes) {
    const std::lock_guard lock(mutex_);
    for (const auto& [principal, more] : bytes) unpaid_.try_emplace(principal);
    for (const auto& [principal, more] : bytes) unpaid_[principal] += more;
    return {this, std::move(bytes)};
}

Budget::Unpaid::~Unpaid() {
    if (bytes_.empty()) return;
    const std::lock_guard lock(budget_->mutex_);
    for (const auto& [principal, bytes] : bytes_) {
        const auto known = budget_->unpaid_.find(principal);
        known->second -= bytes;
        if (known->second == 0) budget_->unpaid_.erase(known);
    }
}

std::uint64_t Budget::unpaid() const {
    const std::lock_guard lock(mutex_);
    std::uint64_t sum = 0;
    for (const auto& [principal, bytes] : unpaid_) sum += bytes;
    return sum;
}

std::uint64_t Budget::used() const {
    const std::lock_guard lock(mutex_);
    return used_[0] + used_[1];
}

std::uint64_t Budget::held_by(const std::string& principal) const {
    const std::lock_guard lock(mutex_);
    const auto found = accounts_.find(principal);
    return found == accounts_.end() ? 0 : found->second[0] + found->second[1];
}

tl::unexpected<protocol::Error> Budget::refuse(const std::string& what, std::uint64_t bytes,
                                               const std::string& principal,
                                               const std::string& remedy) const {
    std::string message =
        what + " takes " + protocol::bytes_text(bytes) + " of raynestd's --memory, more than ";
    message += bytes > fair_part(0, limit_) ? "one user may have" : principal + " may take now";
    return server::refuse(Code::resource_exhausted, message + "; " + remedy);
}

}  // namespace raynest::server
