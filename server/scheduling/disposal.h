// Destroys what holds much memory on a compute thread: the system takes 0.1 s and more to free a
// GiB, and the io thread serves everybody.
#pragma once

#include "server/scheduling/fair_thread_pool.h"

#include <cstdint>
#include <memory>
#include <new>
#include <string>
#include <utility>

namespace raynest::server {

/// Bytes from which on memory is freed on a compute thread; freeing fewer takes less than 0.1 ms.
inline constexpr std::uint64_t disposed_bytes_min = 1ULL << 20;

/// Destroys `thing` on a thread of `pool`, as a task of `principal`; on this thread if memory is
/// short. Its bytes of --memory are the caller's affair.
template <class Thing>
void dispose(FairThreadPool& pool, const std::string& principal, Thing thing) noexcept {
    try {
        pool.submit(principal, Priority::low,
                    [held = std::make_shared<Thing>(std::move(thing))]() mutable { held.reset(); });
    } catch (const std::bad_alloc&) {
        // The destructors of `thing` and of the function have freed it.
    }
}

/// Makes a shared object that is disposed of when its last reference is dropped. The pool must
/// outlive it.
template <class Thing>
std::shared_ptr<const Thing> share_disposable(FairThreadPool& pool, std::string principal,
                                              Thing thing) {
    return {new Thing(std::move(thing)),
            [&pool, principal = std::move(principal)](const Thing* last) {
                dispose(pool, principal, std::unique_ptr<const Thing>(last));
            }};
}

}  // namespace raynest::server
