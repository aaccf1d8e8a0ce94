# cmake -C .ci/tsan.cmake: data-race checks for the server and the scheduler.
set(CMAKE_BUILD_TYPE RelWithDebInfo CACHE STRING "")
set(CMAKE_CXX_FLAGS "-fsanitize=thread -fno-omit-frame-pointer" CACHE STRING "")
set(RAYNEST_TARGETS v3 CACHE STRING "")
set(RAYNEST_BENCH OFF CACHE BOOL "")
