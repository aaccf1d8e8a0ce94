# cmake -C .ci/asan.cmake: address and undefined-behaviour checks; the first report ends the program.
# One pack is enough: the sanitizers look at the source that all targets share. The check of an object's
# type reads it through a pipe and takes it for garbage where descriptors have run out, as in some tests.
set(CMAKE_BUILD_TYPE RelWithDebInfo CACHE STRING "")
set(CMAKE_CXX_FLAGS "-fsanitize=address,undefined -fno-sanitize=vptr -fno-sanitize-recover=all \
-fno-omit-frame-pointer" CACHE STRING "")
set(RAYNEST_TARGETS v3 CACHE STRING "")
# What sanitizers add to inlined kernels takes GCC over 13 minutes per intersector at -O3, six and a half at
# -O1, three without debug information that tells variables.
set(RAYNEST_KERNEL_OPTIMISATION -O1 CACHE STRING "")
set(CMAKE_CXX_FLAGS_RELWITHDEBINFO "-O2 -g1 -fno-var-tracking -DNDEBUG" CACHE STRING "")
set(RAYNEST_BENCH OFF CACHE BOOL "")
set(RAYNEST_TEST_SECONDS 3600 CACHE STRING "")
