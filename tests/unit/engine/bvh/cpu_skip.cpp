// Ends a test binary of one CPU target as skipped where the CPU is another: before anything that
// was compiled for the target runs, its initialisers included. Itself it is compiled for any CPU.
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
