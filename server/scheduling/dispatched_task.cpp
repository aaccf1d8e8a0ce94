#include "server/scheduling/dispatched_task.h"

#include "server/scheduling/fair_thread_pool.h"

#include <chrono>
#include <thread>

namespace raynest::server {

protocol::Error deadline_error() {
    return {Code::deadline,
            "the request's deadline passed; " +
                std::string(protocol::error_info(Code::deadline).remedy),
            0};
}

void post_surely(const Post& post, const std::function<void()>& end) noexcept {
    constexpr std::chrono::milliseconds pause{10};
    for (;;) {
        try {
            return post(end);
        } catch (const std::bad_alloc&) {
            std::this_thread::sleep_for(pause);
        }
    }
}

std::uint64_t dispatch(FairThreadPool& pool, const std::string& principal, Priority priority,
                       const Post& post, DispatchedTaskPointer task) {
    std::function<void()> end = [task] { task->done(std::move(task->reply)); };
    return pool.submit(principal, priority, [task = std::move(task), end = std::move(end), &post] {
        task->run();
        post_surely(post, end);
    });
}

}  // namespace raynest::server
