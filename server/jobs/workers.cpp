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
        const auto [queue, is_new] = queues_.try_emplace(principal);
        if (is_new) turns_.push_back(queue);
        queue->second.push_back({priority, submitted_++, std::move(task)});
        std::push_heap(queue->second.begin(), queue->second.end(), later);
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
    const auto turn = turns_.front();
    turns_.pop_front();
    Queue& queue = turn->second;
    std::pop_heap(queue.begin(), queue.end(), later);
    std::function<void()> task = std::move(queue.back().task);
    queue.pop_back();
    if (queue.empty())
        queues_.erase(turn);
    else
        turns_.push_back(turn);
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
