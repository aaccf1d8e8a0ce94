# cmake -C .ci/release.cmake: what users run and tests measure.
set(CMAKE_BUILD_TYPE Release CACHE STRING "")
