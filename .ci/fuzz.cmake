# cmake -C .ci/fuzz.cmake: the fuzz targets with libFuzzer, which only clang has. With g++ the same
# targets link a main that replays the corpus. clang 14 sees Asio's coroutines only when told so.
set(CMAKE_CXX_COMPILER clang++ CACHE STRING "")
set(CMAKE_BUILD_TYPE RelWithDebInfo CACHE STRING "")
set(CMAKE_CXX_FLAGS "-fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=all \
-DBOOST_ASIO_HAS_CO_AWAIT -DBOOST_ASIO_HAS_STD_COROUTINE" CACHE STRING "")
set(RAYNEST_TARGETS v3 CACHE STRING "")
set(RAYNEST_BENCH OFF CACHE BOOL "")
