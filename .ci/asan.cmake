# Checks addresses and undefined behaviour: cmake -C .ci/asan.cmake. The first report ends the
# program. One pack is enough: the sanitizers check the source that all targets share. The vptr
# check is off: it reads each object through a pipe and sees garbage when descriptors run out, as
# they do in some tests.
set(CMAKE_BUILD_TYPE RelWithDebInfo CACHE STRING "")
set(CMAKE_CXX_FLAGS "-fsanitize=address,undefined -fno-sanitize=vptr -fno-sanitize-recover=all \
-fno-omit-frame-pointer" CACHE STRING "")
set(RAYNEST_TARGETS v3 CACHE STRING "")
# Lower the optimisation: with sanitizers, inlined kernels take GCC over 13 minutes per intersector
# at -O3, six and a half at -O1, and three without debug information about variables.
set(RAYNEST_KERNEL_OPTIMISATION -O1 CACHE STRING "")
set(CMAKE_CXX_FLAGS_RELWITHDEBINFO "-O2 -g1 -fno-var-tracking -DNDEBUG" CACHE STRING "")
# Here each file must include what it uses.
set(CMAKE_DISABLE_PRECOMPILE_HEADERS ON CACHE BOOL "")
set(RAYNEST_BENCH OFF CACHE BOOL "")
set(RAYNEST_TEST_SECONDS 3600 CACHE STRING "")
