// Ends a test binary as skipped if the CPU does not support its target, before any code for the
// target runs, initialisers included. This file is compiled for any CPU.
#include <unistd.h>

#include <cstdio>

namespace {

[[gnu::constructor(101)]] void skip_on_other_cpus() {
    __builtin_cpu_init();
    if (RAYNEST_TEST_CPU) return;
    std::puts("skipped: no " RAYNEST_TEST_TARGET " on this CPU");
    std::fflush(stdout);
    _exit(0);
}

}  // namespace
