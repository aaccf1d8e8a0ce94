#include "server/jobs/workers.h"

#include <algorithm>
#include <utility>

namespace raynest::server {

Workers::Workers(unsigned threads) {
    threads_.reserve(threads);
    for (unsigned i = 0; i < threads; ++i) threads_.emplace_back([this] { run(); });
}

Workers::~Workers() {
    std::map<std::string, Queue> dropped;
    {
        const std::lock_guard lock(mutex_);
        stopping_ = true;
        turns_.clear();
        dropped.swap(queues_);
    }
    wake_.notify_all();
    for (std::thread& thread : threads_) thread.join();
}

bool Workers::later(const Waiting& a, const Waiting& b) {
    return a.priority != b.priority ? a.priority < b.priority : a.number > b.number;
}

void Workers::submit(const std::string& principal, Priority priority, std::function<void()> task) {
    {
        const std::lock_guard lock(mutex_);
        const auto turn = queues_.try_emplace(principal).first;
        Queue& queue = turn->second;
        // Memory first: where it lacks, there must be neither a turn without a task nor a task
        // without a turn.
        if (queue.size() == queue.capacity()) queue.reserve(2 * queue.size() + 1);
        if (queue.empty()) turns_.push_back(turn);
        queue.push_back({priority, submitted_++, std::move(task)});
        std::push_heap(queue.begin(), queue.end(), later);
    }
    wake_.notify_one();
}

bool Workers::run_one() noexcept {
    std::function<void()> task;
    {
        const std::lock_guard lock(mutex_);
        if (turns_.empty()) return false;
        task = take();
    }
    task();
    return true;
}

std::function<void()> Workers::take() {
    Queue& queue = turns_.front()->second;
    std::pop_heap(queue.begin(), queue.end(), later);
    std::function<void()> task = std::move(queue.back().task);
    queue.pop_back();
    if (queue.empty()) {
        queues_.erase(turns_.front());
        turns_.pop_front();
    } else {
        turns_.splice(turns_.end(), turns_, turns_.begin());
    }
    return task;
}

void Workers::run() {
    for (;;) {
        std::function<void()> task;
        {
            std::unique_lock lock(mutex_);
            wake_.wait(lock, [this] { return stopping_ || !turns_.empty(); });
            if (stopping_) return;
            task = take();
        }
        task();
    }
}

}  // namespace raynest::server
