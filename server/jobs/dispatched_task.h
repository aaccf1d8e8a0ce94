// A task on its way to a thread and back.
#pragma once

#include "server/jobs/job.h"

#include <exception>
#include <functional>
#include <memory>
#include <new>
#include <string>
#include <utility>

namespace raynest::server {

/// To the io thread; thread-safe.
using Post = std::function<void(std::function<void()>)>;

/// Why a job ends whose deadline passed.
[[nodiscard]] protocol::Error deadline_error();

/// The border between tasks and the exceptions of libraries: whatever happens fails this job alone.
/// `work` gives a Reply<Frames> and does not run for a job that must end.
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

/// Takes a task out of its queue; false once a thread has begun it. Needs no memory.
using TryDequeue = std::function<bool()>;

/// All that the way back needs is allocated before a task leaves, where a lack of memory fails its
/// job and not the thread.
struct DispatchedTask {
    std::shared_ptr<const StopFlag> stop;
    Task task;
    std::function<void(Reply<Frames>)> done;  ///< on the io thread, takes the reply
    Reply<Frames> reply = {};

    /// On the thread that runs it.
    void run() noexcept {
        reply = run_guarded(*stop, [this] { return task.run(*stop); });
    }
};
using DispatchedTaskPointer = std::shared_ptr<DispatchedTask>;

/// Posts the end of what a thread has done. A completion that got lost would leave its job for
/// ever: without memory it waits for some.
void post_surely(const Post& post, const std::function<void()>& end) noexcept;

/// Has `pool` run the task and post its end. Gives the number by which the pool knows it.
std::uint64_t dispatch(FairThreadPool& pool, const std::string& principal, Priority priority,
                       const Post& post, DispatchedTaskPointer task);

}  // namespace raynest::server
