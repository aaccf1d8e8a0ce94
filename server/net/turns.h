// Shares the turns of the io thread among principals, and those of each among its connections.
//
// All connections of a principal together keep the io thread for turn_time, or for one message. Then
// they wait in line, and one of them goes on after a round of the loop, which has looked at all sockets
// meanwhile: each other principal has had its turn. A round costs a system call, so none begins
// before somebody has kept the io thread for so long.
#pragma once

#include "server/ground/io_turn.h"
#include "server/net/asio.h"

#include <chrono>
#include <cstddef>
#include <list>
#include <memory>
#include <string>
#include <unordered_map>

namespace raynest::server {

/// One for each io_context. Io thread only.
class Turns final : public asio::execution_context::service {
public:
    using Clock = std::chrono::steady_clock;
    using key_type = Turns;

    static inline asio::execution_context::id id;  // NOLINT: asio names it

    explicit Turns(asio::execution_context& io);
    /// Returns the one of the io_context that runs an object's handlers.
    template <class Object>
    static Turns& of(Object& object) {
        return asio::use_service<Turns>(
            asio::query(object.get_executor(), asio::execution::context));
    }

    /// True if connections of the principal have used up its turn, or others of them wait in line.
    [[nodiscard]] bool is_over(const std::string& principal) const {
        return left(principal) <= Clock::duration();
    }
    /// Returns how long the turn may still last.
    [[nodiscard]] Clock::duration left(const std::string& principal) const;
    /// Waits in line. Who has waited goes on with one message without asking again.
    asio::awaitable<void> wait(std::string principal);
    /// Waits in line: the timer that is returned ends then.
    [[nodiscard]] std::shared_ptr<asio::steady_timer> stand_in_line(const std::string& principal);
    /// Counts time that a connection of the principal has kept the io thread.
    void spend(const std::string& principal, Clock::duration time);
    /// Returns all time that was counted.
    [[nodiscard]] Clock::duration spent() const { return spent_; }

private:
    struct Account {
        Clock::duration used{};
        std::list<std::shared_ptr<asio::steady_timer>> line;  ///< they wait for its end
    };
    void shutdown() noexcept override { accounts_.clear(); }
    void begin_round();
    void end_round();
    static void let_next_go(Account& account);

    asio::io_context& io_;
    /// Principals of these accounts are forgotten at the end of a round.
    static constexpr std::size_t accounts_max = 1024;
    std::unordered_map<std::string, Account> accounts_;
    bool is_round_ = false;
    Clock::duration spent_{};
};

/// Counts for a principal how long a scope keeps the io thread, less what is counted within it.
/// Scopes do not wait. Io thread only.
class TurnMeter {
public:
    /// Nothing is counted for null.
    TurnMeter(Turns& turns, std::shared_ptr<const std::string> principal) noexcept;
    TurnMeter(const TurnMeter&) = delete;
    ~TurnMeter();
    /// Counts what the innermost scope has taken so far.
    static void count_present() noexcept;

private:
    void count() noexcept;

    static inline TurnMeter* present_ = nullptr;
    Turns& turns_;
    const std::shared_ptr<const std::string> principal_;
    TurnMeter* const outer_;
    Turns::Clock::time_point since_;
    Turns::Clock::duration counted_;
};

}  // namespace raynest::server
