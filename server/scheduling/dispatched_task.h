// Sends a task to a pool thread and its result back to the io thread.
#pragma once

#include "server/ground/io_turn.h"
#include "server/scheduling/job.h"

#include <exception>
#include <functional>
#include <memory>
#include <new>
#include <string>

namespace raynest::server {

/// Returns the error of a job whose deadline has passed.
[[nodiscard]] protocol::Error deadline_error();

/// Runs `work`, which returns a Reply<Frames>, unless its job must stop. Converts exceptions to
/// errors, so that they fail only this job.
template <class Work>
Reply<Frames> run_guarded(const StopFlag& stop, Work&& work) noexcept {
    try {
        if (stop.requested()) return refuse(Code::cancelled, "");
        if (stop.expired()) return tl::unexpected(deadline_error());
        return work();
    } catch (const std::bad_alloc&) {
        return refuse(Code::resource_exhausted, "");
    } catch (const std::exception& error) {
        return refuse(Code::internal, error.what());
    } catch (...) {
        return refuse(Code::internal, "a task failed without saying why");
    }
}

/// Takes a task out of its queue; returns false once a thread has started it. Allocates no memory.
using TryDequeue = std::function<bool()>;

/// A task with everything that its completion needs. It is allocated before the task is submitted,
/// so that a lack of memory fails the job and not the thread.
struct DispatchedTask {
    std::shared_ptr<const StopFlag> stop;
    Task task;
    std::function<void(Reply<Frames>)> done;  ///< called with `reply` on the io thread
    Reply<Frames> reply = {};

    /// Runs the task on a pool thread.
    void run() noexcept {
        reply = run_guarded(*stop, [this] { return task.run(*stop); });
    }
};
using DispatchedTaskPointer = std::shared_ptr<DispatchedTask>;

/// Posts a completion. Waits while memory is short: without its completion a job would never end.
void post_surely(const Post& post, const std::function<void()>& end) noexcept;

/// Submits the task to `pool` and posts its completion. Returns its number for
/// FairThreadPool::change().
std::uint64_t dispatch(FairThreadPool& pool, const std::string& principal, Priority priority,
                       const Post& post, DispatchedTaskPointer task);

}  // namespace raynest::server
