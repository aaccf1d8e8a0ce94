# cmake -C .ci/release.cmake: the build that users run and tests measure.
set(CMAKE_BUILD_TYPE Release CACHE STRING "")
set(RAYNEST_UNITY ON CACHE BOOL "")
