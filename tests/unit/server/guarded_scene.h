// Counts the pages of a scene that a function looks at.
#pragma once

#include <signal.h>
#include <sys/mman.h>

#include <cstddef>
#include <cstdint>
#include <span>

namespace raynest::test {

/// Takes a scene's pages away while count() runs; the first access to each gives it back. One at a
/// time, on one thread.
class GuardedScene {
public:
    explicit GuardedScene(std::span<const std::byte> arena) {
        const auto begin = reinterpret_cast<std::uintptr_t>(arena.data());
        first_ = (begin + page - 1) / page * page;
        end_ = (begin + arena.size()) / page * page;
        struct sigaction guard {};
        guard.sa_sigaction = give_back;
        guard.sa_flags = SA_SIGINFO | SA_NODEFER;
        sigaction(SIGSEGV, &guard, &before_);
    }
    GuardedScene(const GuardedScene&) = delete;
    ~GuardedScene() { sigaction(SIGSEGV, &before_, nullptr); }

    /// Returns the number of pages that `function` has read.
    template <class Function>
    std::size_t count(Function&& function) {
        pages_ = 0;
        protect(first_, end_ - first_, PROT_NONE);
        function();
        protect(first_, end_ - first_, PROT_READ | PROT_WRITE);
        return pages_;
    }

private:
    static constexpr std::uintptr_t page = 4096;

    static void protect(std::uintptr_t at, std::size_t size, int how) {
        if (mprotect(reinterpret_cast<void*>(at), size, how) != 0) abort();
    }
    static void give_back(int signal, siginfo_t* info, void* /*context*/) {
        const auto at = reinterpret_cast<std::uintptr_t>(info->si_addr);
        if (at < first_ || at >= end_) {
            ::signal(signal, SIG_DFL);  // a fault of the program: it comes again
            return;
        }
        ++pages_;
        protect(at / page * page, page, PROT_READ | PROT_WRITE);
    }

    static inline std::uintptr_t first_ = 0;
    static inline std::uintptr_t end_ = 0;
    static inline std::size_t pages_ = 0;
    struct sigaction before_ {};
};

}  // namespace raynest::test
