#include "server/net/turns.h"

#include <new>
#include <utility>

namespace raynest::server {

Turns::Turns(asio::execution_context& io) : service(io), io_(static_cast<asio::io_context&>(io)) {}

void Turns::begin_round() {
    if (is_round_) return;
    asio::post(io_, [this] { end_round(); });
    is_round_ = true;
}

void Turns::let_next_go(Account& account) {
    if (account.line.empty()) return;
    account.line.front()->cancel();
    account.line.pop_front();
}

void Turns::end_round() {
    is_round_ = false;
    std::erase_if(accounts_, [](const auto& account) { return account.second.line.empty(); });
    for (auto& [principal, account] : accounts_) {
        account.used = {};
        let_next_go(account);
    }
    // Those that go on now are followed by others of their lines.
    if (!accounts_.empty()) begin_round();
}

Turns::Clock::duration Turns::left(const std::string& principal) const {
    const auto known = accounts_.find(principal);
    if (known == accounts_.end()) return turn_time;
    return known->second.line.empty() ? turn_time - known->second.used : Clock::duration();
}

std::shared_ptr<asio::steady_timer> Turns::stand_in_line(const std::string& principal) {
    const auto end = std::make_shared<asio::steady_timer>(io_, Clock::time_point::max());
    begin_round();
    accounts_[principal].line.push_back(end);
    return end;
}

asio::awaitable<void> Turns::wait(std::string principal) {
    const auto end = stand_in_line(principal);
    SystemError ignored;
    co_await end->async_wait(asio::redirect_error(asio::use_awaitable, ignored));
}

void Turns::spend(const std::string& principal, Clock::duration time) {
    Account& account = accounts_[principal];
    account.used += time;
    spent_ += time;
    if (account.used < turn_time) let_next_go(account);
    if (account.used >= turn_time || accounts_.size() > accounts_max) begin_round();
}

TurnMeter::TurnMeter(Turns& turns, std::shared_ptr<const std::string> principal) noexcept
    : turns_(turns),
      principal_(std::move(principal)),
      outer_(std::exchange(present_, this)),
      since_(Turns::Clock::now()),
      counted_(turns.spent()) {}

TurnMeter::~TurnMeter() {
    count();
    present_ = outer_;
}

void TurnMeter::count_present() noexcept {
    if (present_ != nullptr) present_->count();
}

void TurnMeter::count() noexcept {
    const auto now = Turns::Clock::now();
    const auto time = now - since_ - (turns_.spent() - counted_);
    try {
        if (principal_ && time > Turns::Clock::duration()) turns_.spend(*principal_, time);
    } catch (const std::bad_alloc&) {
        // Uncounted: the principal has no account, so it has not used much.
    }
    since_ = now;
    counted_ = turns_.spent();
}

}  // namespace raynest::server
