#include "server/jobs/workers.h"

#include <time.h>

#include <algorithm>
#include <utility>

namespace raynest::server {
namespace {

/// Some seconds: a task that hung must not cost its principal the rest of the day.
constexpr std::int64_t debt_max = 1000;

/// Of the processor: what the rest of the machine does is nobody's debt.
std::chrono::nanoseconds thread_time() {
    timespec now{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return std::chrono::seconds(now.tv_sec) + std::chrono::nanoseconds(now.tv_nsec);
}

}  // namespace

Workers::Workers(unsigned threads) {
    threads_.reserve(threads);
    for (unsigned i = 0; i < threads; ++i) threads_.emplace_back([this] { run(); });
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
    for (std::thread& thread : threads_) thread.join();
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
        if (queue.empty()) turns_.push_back(account);
        number = submitted_++;
        queue.push_back({priority, number, std::move(task)});
        std::push_heap(queue.begin(), queue.end(), later);
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
        taken = take();
    }
    run_taken(std::move(taken));
    return true;
}

Workers::Taken Workers::take() {
    // Without others nobody is kept waiting: nothing is owed.
    if (turns_.size() == 1) turns_.front()->second.debt = 0;
    while (turns_.front()->second.debt > 0) {
        --turns_.front()->second.debt;
        turns_.splice(turns_.end(), turns_, turns_.begin());
    }
    const Accounts::iterator account = turns_.front();
    std::vector<Waiting>& queue = account->second.queue;
    std::pop_heap(queue.begin(), queue.end(), later);
    Taken taken{account, std::move(queue.back().task)};
    queue.pop_back();
    ++account->second.running;
    if (queue.empty())
        turns_.pop_front();
    else
        turns_.splice(turns_.end(), turns_, turns_.begin());
    return taken;
}

void Workers::run_taken(Taken taken) {
    const auto start = thread_time();
    taken.task();
    taken.task = {};  // what it holds goes before the next one is taken
    const auto turns = (thread_time() - start) / slice;

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
            taken = take();
        }
        run_taken(std::move(taken));
    }
}

}  // namespace raynest::server
