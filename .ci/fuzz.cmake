# Builds the fuzz targets with libFuzzer, which only clang has: cmake -C .ci/fuzz.cmake. With g++
# the same targets link a main that replays the corpus. clang 14 cannot compile its check of
# function types in coroutines.
set(CMAKE_CXX_COMPILER clang++ CACHE STRING "")
set(CMAKE_BUILD_TYPE RelWithDebInfo CACHE STRING "")
set(CMAKE_CXX_FLAGS "-fsanitize=fuzzer-no-link,address,undefined -fno-sanitize=function \
-fno-sanitize-recover=all" CACHE STRING "")
set(RAYNEST_TARGETS v3 CACHE STRING "")
# Here each file must include what it uses.
set(CMAKE_DISABLE_PRECOMPILE_HEADERS ON CACHE BOOL "")
set(RAYNEST_BENCH OFF CACHE BOOL "")
