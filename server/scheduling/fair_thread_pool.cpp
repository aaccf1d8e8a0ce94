#include "server/scheduling/fair_thread_pool.h"

#include "server/ground/fair_share.h"

#include <time.h>

#include <algorithm>
#include <exception>
#include <utility>

namespace raynest::server {
namespace {

/// Maximum debt of a principal in turns, 4 s: bounds the cost of a task that hung.
constexpr std::int64_t debt_max = 1000;

std::chrono::nanoseconds now_by(FairThreadPool::Time time) {
    timespec now{};
    clock_gettime(
        time == FairThreadPool::Time::processor ? CLOCK_THREAD_CPUTIME_ID : CLOCK_MONOTONIC, &now);
    return std::chrono::seconds(now.tv_sec) + std::chrono::nanoseconds(now.tv_nsec);
}

}  // namespace

FairThreadPool::FairThreadPool(unsigned threads, Time charged, unsigned spares,
                               unsigned places_each)
    : charged_(charged),
      spares_max_(spares),
      places_each_(places_each),
      regulars_(threads) {
    try {
        for (WorkerThread& worker : regulars_)
            worker.thread = std::jthread([this, &worker] { run(worker); });
        if (spares != 0) watch_ = std::thread([this] { watch(); });
    } catch (...) {
        stop();
        throw;
    }
}

FairThreadPool::~FairThreadPool() {
    stop();
}

void FairThreadPool::stop() {
    Accounts dropped;
    {
        const std::lock_guard lock(mutex_);
        stopping_ = true;
        turns_.clear();
        dropped.swap(accounts_);
    }
    wake_.notify_all();
    wake_spare_.notify_all();
    alarm_.notify_one();
    if (watch_.joinable()) watch_.join();  // first, because it starts spare threads
    for (WorkerThread& worker : regulars_) {
        if (worker.thread.joinable()) worker.thread.join();
    }
    for (WorkerThread& worker : spares_) worker.thread.join();
}

bool FairThreadPool::later(const Waiting& a, const Waiting& b) {
    return a.priority != b.priority ? a.priority < b.priority : a.number > b.number;
}

std::uint64_t FairThreadPool::submit(const std::string& principal, Priority priority,
                                     std::function<void()> task) {
    std::uint64_t number = 0;
    {
        const std::lock_guard lock(mutex_);
        const auto account = accounts_.try_emplace(principal).first;
        std::vector<Waiting>& queue = account->second.queue;
        // Allocate first: if that throws, no turn lacks a task and no task lacks a turn.
        if (queue.size() == queue.capacity()) queue.reserve(2 * queue.size() + 1);
        if (queue.empty()) turns_.push_back(account);
        number = submitted_++;
        queue.push_back({priority, number, std::move(task)});
        std::push_heap(queue.begin(), queue.end(), later);
        const bool lacks_thread = account->second.running == 0 && running_ >= threads();
        alarmed_ = alarmed_ || lacks_thread;
        if (std::exchange(resting_, false) || lacks_thread) alarm_.notify_one();
    }
    wake_.notify_one();
    wake_spare_.notify_one();
    return number;
}

bool FairThreadPool::change(const std::string& principal, std::uint64_t number,
                            const std::function<bool()>& change) {
    std::function<void()> dropped;  // destroyed after the lock is released
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

bool FairThreadPool::run_one() noexcept {
    WorkerThread here;
    Taken taken;
    {
        const std::lock_guard lock(mutex_);
        const auto turn = next_in_turn();
        if (turn == turns_.end()) return false;
        taken = take(turn, here);
    }
    run_taken(std::move(taken), here);
    return true;
}

bool FairThreadPool::has_place(const Account& account) const {
    if (places_each_ == 0) return true;
    return account.running < places_each_ &&
           fair_place(account.running, threads() - std::min(running_, threads()));
}

FairThreadPool::Turns::iterator FairThreadPool::next_in_turn() {
    const auto may_run = [this](Accounts::iterator account) { return has_place(account->second); };
    const auto candidates = std::ranges::count_if(turns_, may_run);
    if (candidates == 0) return turns_.end();
    for (;;) {
        Account& next = turns_.front()->second;
        // Ignore the debt of a principal that waits alone: it delays no other.
        if (has_place(next) && (candidates == 1 || next.debt == 0)) {
            if (candidates == 1) next.debt = 0;
            return turns_.begin();
        }
        if (has_place(next)) --next.debt;
        turns_.splice(turns_.end(), turns_, turns_.begin());
    }
}

FairThreadPool::Turns::iterator FairThreadPool::least_served() {
    const auto least = std::min_element(turns_.begin(), turns_.end(), [](auto a, auto b) {
        return a->second.running < b->second.running;
    });
    const std::size_t most = threads() + spares_max_ / 2;
    return least != turns_.end() && (*least)->second.running < most ? least : turns_.end();
}

FairThreadPool::Taken FairThreadPool::take(Turns::iterator turn, WorkerThread& worker) {
    const Accounts::iterator account = *turn;
    std::vector<Waiting>& queue = account->second.queue;
    std::pop_heap(queue.begin(), queue.end(), later);
    Taken taken{account, std::move(queue.back().task)};
    queue.pop_back();
    ++account->second.running;
    ++running_;
    if (queue.empty())
        turns_.erase(turn);
    else
        turns_.splice(turns_.end(), turns_, turn);
    worker.since = Clock::now();
    return taken;
}

void FairThreadPool::run_taken(Taken taken, WorkerThread& worker) {
    const auto start = now_by(charged_);
    taken.task();
    taken.task = {};  // release its captures before the next task is taken
    const auto turns = (now_by(charged_) - start) / slice;

    const std::lock_guard lock(mutex_);
    worker.since = Clock::time_point::max();
    --running_;
    if (stopping_) return;  // stop() has removed the accounts
    Account& account = taken.account->second;
    account.debt = std::min<std::int64_t>(account.debt + turns, debt_max);
    if (--account.running == 0 && account.queue.empty() && account.debt == 0)
        accounts_.erase(taken.account);
    // Forget all debts when no task waits.
    if (turns_.empty())
        std::erase_if(accounts_, [](const auto& entry) { return entry.second.running == 0; });
}

void FairThreadPool::run(WorkerThread& self) {
    for (;;) {
        Taken taken;
        {
            std::unique_lock lock(mutex_);
            Turns::iterator turn;
            wake_.wait(lock, [&] { return stopping_ || (turn = next_in_turn()) != turns_.end(); });
            if (stopping_) return;
            taken = take(turn, self);
        }
        // The end of a task may have freed places for more than one.
        if (places_each_ != 0) wake_.notify_one();
        run_taken(std::move(taken), self);
    }
}

std::size_t FairThreadPool::held(std::chrono::milliseconds time) const {
    const Clock::time_point long_ago = Clock::now() - time;
    const auto is_held = [long_ago](const WorkerThread& worker) {
        return worker.since <= long_ago;
    };
    return static_cast<std::size_t>(std::ranges::count_if(regulars_, is_held) +
                                    std::ranges::count_if(spares_, is_held));
}

std::chrono::nanoseconds FairThreadPool::longest_task() {
    const std::lock_guard lock(mutex_);
    const Clock::time_point now = Clock::now();
    std::chrono::nanoseconds longest{0};
    const auto look = [&](const WorkerThread& worker) {
        if (worker.since < now) longest = std::max(longest, now - worker.since);
    };
    std::ranges::for_each(regulars_, look);
    std::ranges::for_each(spares_, look);
    return longest;
}

bool FairThreadPool::needs_spare() {
    const auto turn = least_served();
    if (turn == turns_.end() || spares_.size() >= spares_max_) return false;
    return spares_.size() < held(patience) ||
           ((*turn)->second.running == 0 && spares_.size() < threads() &&
            held(turn_patience) == threads() + spares_.size());
}

void FairThreadPool::watch() {
    std::unique_lock lock(mutex_);
    for (std::uint64_t seen = submitted_; !stopping_;) {
        std::erase_if(spares_, [](const WorkerThread& worker) { return worker.over; });
        while (needs_spare() && start_spare()) {
        }
        if (submitted_ != seen || !turns_.empty() || !spares_.empty()) {
            seen = submitted_;
            alarm_.wait_for(lock, turn_patience,
                            [this] { return stopping_ || std::exchange(alarmed_, false); });
        } else {
            resting_ = true;
            alarm_.wait(lock, [this] { return stopping_ || !resting_; });
        }
    }
}

bool FairThreadPool::start_spare() {
    try {
        WorkerThread& worker = spares_.emplace_back();
        worker.thread = std::jthread([this, &worker] { run_spare(worker); });
        return true;
    } catch (const std::exception&) {  // no memory or no thread; the watch tries again later
        std::erase_if(spares_,
                      [](const WorkerThread& worker) { return !worker.thread.joinable(); });
        return false;
    }
}

FairThreadPool::Turns::iterator FairThreadPool::next_for_spare() {
    const auto turn = least_served();
    if (turn == turns_.end() || (*turn)->second.running == 0) return turn;
    const auto serving = std::ranges::count(spares_, false, &WorkerThread::over);
    return static_cast<std::size_t>(serving) <= held(patience) ? turn : turns_.end();
}

void FairThreadPool::run_spare(WorkerThread& self) {
    std::unique_lock lock(mutex_);
    for (;;) {
        Turns::iterator turn;
        const bool is_needed = wake_spare_.wait_for(
            lock, patience, [&] { return stopping_ || (turn = next_for_spare()) != turns_.end(); });
        if (stopping_ || !is_needed) break;
        Taken taken = take(turn, self);
        lock.unlock();
        run_taken(std::move(taken), self);
        lock.lock();
    }
    self.over = true;
}

}  // namespace raynest::server
