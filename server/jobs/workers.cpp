#include "server/jobs/workers.h"

#include <time.h>

#include <algorithm>
#include <exception>
#include <utility>

namespace raynest::server {
namespace {

/// Some seconds: a task that hung must not cost its principal the rest of the day.
constexpr std::int64_t debt_max = 1000;

std::chrono::nanoseconds now_by(Workers::Time time) {
    timespec now{};
    clock_gettime(time == Workers::Time::processor ? CLOCK_THREAD_CPUTIME_ID : CLOCK_MONOTONIC,
                  &now);
    return std::chrono::seconds(now.tv_sec) + std::chrono::nanoseconds(now.tv_nsec);
}

}  // namespace

Workers::Workers(unsigned threads, Time charged, unsigned spares)
    : charged_(charged),
      spares_max_(spares) {
    threads_.reserve(threads);
    for (unsigned i = 0; i < threads; ++i) threads_.emplace_back([this] { run(); });
    if (spares != 0) watch_ = std::thread([this] { watch(); });
}

Workers::~Workers() {
    Accounts dropped;
    {
        const std::lock_guard lock(mutex_);
        stopping_ = true;
        turns_.clear();
        dropped.swap(accounts_);
    }
    wake_.notify_all();
    alarm_.notify_one();
    if (watch_.joinable()) watch_.join();  // first: it starts others
    for (std::thread& thread : threads_) thread.join();
    spares_.clear();
}

bool Workers::later(const Waiting& a, const Waiting& b) {
    return a.priority != b.priority ? a.priority < b.priority : a.number > b.number;
}

std::uint64_t Workers::submit(const std::string& principal, Priority priority,
                              std::function<void()> task) {
    std::uint64_t number = 0;
    {
        const std::lock_guard lock(mutex_);
        const auto account = accounts_.try_emplace(principal).first;
        std::vector<Waiting>& queue = account->second.queue;
        // Memory first: where it lacks, there must be neither a turn without a task nor a task
        // without a turn.
        if (queue.size() == queue.capacity()) queue.reserve(2 * queue.size() + 1);
        if (queue.empty()) {
            if (turns_.empty()) waiting_since_ = Clock::now();
            turns_.push_back(account);
        }
        number = submitted_++;
        queue.push_back({priority, number, std::move(task)});
        std::push_heap(queue.begin(), queue.end(), later);
        if (std::exchange(resting_, false)) alarm_.notify_one();
    }
    wake_.notify_one();
    return number;
}

bool Workers::change(const std::string& principal, std::uint64_t number,
                     const std::function<bool()>& change) {
    std::function<void()> dropped;  // goes after the lock
    const std::lock_guard lock(mutex_);
    const auto account = accounts_.find(principal);
    if (account == accounts_.end()) return false;
    std::vector<Waiting>& queue = account->second.queue;
    const auto task = std::find_if(queue.begin(), queue.end(), [&](const Waiting& waiting) {
        return waiting.number == number;
    });
    if (task == queue.end()) return false;
    if (change()) return true;
    dropped = std::move(task->task);
    queue.erase(task);
    std::make_heap(queue.begin(), queue.end(), later);
    if (queue.empty()) turns_.remove(account);
    return true;
}

bool Workers::run_one() noexcept {
    Taken taken;
    {
        const std::lock_guard lock(mutex_);
        if (turns_.empty()) return false;
        taken = take(next_in_turn());
    }
    run_taken(std::move(taken));
    return true;
}

Workers::Turns::iterator Workers::next_in_turn() {
    // Without others nobody is kept waiting: nothing is owed.
    if (turns_.size() == 1) turns_.front()->second.debt = 0;
    while (turns_.front()->second.debt > 0) {
        --turns_.front()->second.debt;
        turns_.splice(turns_.end(), turns_, turns_.begin());
    }
    return turns_.begin();
}

Workers::Turns::iterator Workers::least_served() {
    const auto least = std::min_element(turns_.begin(), turns_.end(), [](auto a, auto b) {
        return a->second.running < b->second.running;
    });
    const std::size_t most = threads_.size() + spares_max_ / 2;
    return least != turns_.end() && (*least)->second.running < most ? least : turns_.end();
}

Workers::Taken Workers::take(Turns::iterator turn) {
    const Accounts::iterator account = *turn;
    std::vector<Waiting>& queue = account->second.queue;
    std::pop_heap(queue.begin(), queue.end(), later);
    Taken taken{account, std::move(queue.back().task)};
    queue.pop_back();
    ++account->second.running;
    if (queue.empty())
        turns_.erase(turn);
    else
        turns_.splice(turns_.end(), turns_, turn);
    waiting_since_ = Clock::now();
    return taken;
}

void Workers::run_taken(Taken taken) {
    const auto start = now_by(charged_);
    taken.task();
    taken.task = {};  // what it holds goes before the next one is taken
    const auto turns = (now_by(charged_) - start) / slice;

    const std::lock_guard lock(mutex_);
    if (stopping_) return;  // the accounts are gone
    Account& account = taken.account->second;
    account.debt = std::min<std::int64_t>(account.debt + turns, debt_max);
    if (--account.running == 0 && account.queue.empty() && account.debt == 0)
        accounts_.erase(taken.account);
    // Nobody waits: who asks next starts without a debt.
    if (turns_.empty())
        std::erase_if(accounts_, [](const auto& entry) { return entry.second.running == 0; });
}

void Workers::run() {
    for (;;) {
        Taken taken;
        {
            std::unique_lock lock(mutex_);
            wake_.wait(lock, [this] { return stopping_ || !turns_.empty(); });
            if (stopping_) return;
            taken = take(next_in_turn());
            ++taken_;
        }
        run_taken(std::move(taken));
    }
}

void Workers::watch() {
    std::unique_lock lock(mutex_);
    while (!stopping_) {
        const std::uint64_t before = submitted_;
        alarm_.wait_for(lock, patience, [this] { return stopping_; });
        std::erase_if(spares_, [](const Spare& spare) { return spare.over; });
        if (Clock::now() >= waiting_since_ + patience && least_served() != turns_.end())
            start_spare();
        if (submitted_ != before || !turns_.empty() || !spares_.empty()) continue;
        resting_ = true;
        alarm_.wait(lock, [this] { return stopping_ || !resting_; });
    }
}

void Workers::start_spare() {
    if (spares_.size() == spares_max_) return;
    try {
        Spare& spare = spares_.emplace_back();
        spare.thread = std::jthread([this, &spare] { run_spare(spare); });
    } catch (const std::exception&) {  // no memory, or no thread: later, perhaps
        std::erase_if(spares_, [](const Spare& spare) { return !spare.thread.joinable(); });
    }
}

void Workers::run_spare(Spare& self) {
    std::unique_lock lock(mutex_);
    const std::uint64_t before = taken_;
    while (!stopping_ && taken_ == before) {
        const auto turn = least_served();
        if (turn == turns_.end()) break;
        Taken taken = take(turn);
        lock.unlock();
        run_taken(std::move(taken));
        lock.lock();
    }
    self.over = true;
}

}  // namespace raynest::server
