# cmake -C .ci/tsan.cmake: data-race checks for the server and the scheduler. Asio counts references
# with a fence, which the checks do not know; with one io thread that is no matter (-Wtsan says so).
set(CMAKE_BUILD_TYPE RelWithDebInfo CACHE STRING "")
set(CMAKE_CXX_FLAGS "-fsanitize=thread -fno-omit-frame-pointer -Wno-tsan" CACHE STRING "")
set(RAYNEST_TARGETS v3 CACHE STRING "")
# What sanitizers add to inlined kernels takes GCC over 13 minutes per intersector at -O3, six and a half at
# -O1, three without debug information that tells variables.
set(RAYNEST_KERNEL_OPTIMISATION -O1 CACHE STRING "")
set(CMAKE_CXX_FLAGS_RELWITHDEBINFO "-O2 -g1 -fno-var-tracking -DNDEBUG" CACHE STRING "")
set(RAYNEST_BENCH OFF CACHE BOOL "")
set(RAYNEST_TEST_SECONDS 3600 CACHE STRING "")
