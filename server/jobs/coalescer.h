// Small tasks that ask the same question become one.
//
//   tasks of one turn of the io thread ──same question──► group ──end of turn──► worker
//
// A worker's wakeup costs as much as some ten rays, and a few rays leave a traversal's lanes empty.
// So what comes between two looks at the sockets, from whatever connections of a principal, goes
// through one call of the kernel: 30 connections with requests of 8 to 32 rays cost 8 to 18 % less
// of the daemon's CPU time per request. Nothing waits for others to come.
//
// Nor for others to end: where the common call fails, takes long or has a member that must end,
// each becomes a task of its own.
#pragma once

#include "server/diag/metrics.h"
#include "server/execution/fair_thread_pool.h"
#include "server/jobs/dispatched_task.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace raynest::server {

/// Io thread only; must outlive what it posts.
class Coalescer {
public:
    Coalescer() = default;
    Coalescer(const Coalescer&) = delete;

    /// Where groups go; `post` puts the end of the turn behind whatever is ready to be handled now.
    struct Way {
        FairThreadPool& pool;
        const Post& post;
        Metrics& metrics;
    };
    /// Takes a task that is mergeable.
    TryDequeue add(const Way& way, const std::string& principal, Priority priority,
                   DispatchedTaskPointer task);

private:
    struct Group;
    void end_turn();

    std::vector<std::shared_ptr<Group>> groups_;
};

}  // namespace raynest::server
