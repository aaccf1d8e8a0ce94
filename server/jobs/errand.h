// A task on its way to a worker and back.
#pragma once

#include "server/jobs/job.h"

#include <exception>
#include <functional>
#include <memory>
#include <new>

namespace raynest::server {

/// To the io thread; thread-safe.
using Post = std::function<void(std::function<void()>)>;

/// Posts `done`. A completion that got lost would leave its job for ever: without memory it waits
/// for some.
void post_surely(const Post& post, const std::function<void()>& done) noexcept;

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

/// Takes a task back; false once it was begun. Needs no memory.
using Withdraw = std::function<bool()>;

/// What the way back needs is allocated before a task leaves, where a lack of memory fails its job
/// and not the worker.
struct Errand {
    std::shared_ptr<const StopFlag> stop;
    Task task;
    std::shared_ptr<Reply<Frames>> reply;
    std::function<void()> done;  ///< takes the reply; on the io thread

    void run() const noexcept {
        *reply = run_guarded(*stop, [this] { return task.run(*stop); });
    }
};

}  // namespace raynest::server
