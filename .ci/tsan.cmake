# Checks the server and the scheduler for data races: cmake -C .ci/tsan.cmake. Asio counts
# references with a fence, which the checks do not support; with one io thread this is harmless
# (-Wtsan warns of it).
set(CMAKE_BUILD_TYPE RelWithDebInfo CACHE STRING "")
set(CMAKE_CXX_FLAGS "-fsanitize=thread -fno-omit-frame-pointer -Wno-tsan" CACHE STRING "")
set(RAYNEST_TARGETS v3 CACHE STRING "")
# Lower the optimisation: with sanitizers, inlined kernels take GCC over 13 minutes per intersector
# at -O3, six and a half at -O1, and three without debug information about variables.
set(RAYNEST_KERNEL_OPTIMISATION -O1 CACHE STRING "")
set(CMAKE_CXX_FLAGS_RELWITHDEBINFO "-O2 -g1 -fno-var-tracking -DNDEBUG" CACHE STRING "")
# Here each file must include what it uses.
set(CMAKE_DISABLE_PRECOMPILE_HEADERS ON CACHE BOOL "")
set(RAYNEST_BENCH OFF CACHE BOOL "")
set(RAYNEST_TEST_SECONDS 3600 CACHE STRING "")
