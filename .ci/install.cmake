# Defines what `cmake --install` installs, in two components:
#   runtime      bin/raynestd, bin/raynest, lib/raynest/ (the kernel packs and, in shading/, the
#                integrators for each target, in images/ the modules for pictures and Draco) and lib/raynest-cuda/; all found relative to bin/
#   development  the engine's headers and the pack sources in their own folders under
#                include/raynest/, so that find_package(raynest) gives raynest_kernel_pack()
include(CMakePackageConfigHelpers)

install(TARGETS ${RAYNEST_PACKS} LIBRARY DESTINATION lib/raynest COMPONENT runtime)
get_property(shading GLOBAL PROPERTY RAYNEST_SHADING_MODULES)
install(TARGETS ${shading} LIBRARY DESTINATION lib/raynest/shading COMPONENT runtime)
foreach(module raynest_images raynest_draco)
    if(TARGET ${module})
        install(TARGETS ${module} LIBRARY DESTINATION lib/raynest/images COMPONENT runtime)
    endif()
endforeach()
if(TARGET pack_cuda)
    install(TARGETS pack_cuda LIBRARY DESTINATION lib/raynest-cuda COMPONENT runtime)
endif()
install(TARGETS raynestd raynest RUNTIME DESTINATION bin COMPONENT runtime)

install(DIRECTORY engine DESTINATION include/raynest COMPONENT development
    FILES_MATCHING
    PATTERN "*.h" PATTERN "*.def" PATTERN "LIST" PATTERN "PRIMITIVES"
    PATTERN "packs/pack.*" PATTERN "packs/variant.cpp"
    PATTERN "assets" EXCLUDE PATTERN "scene" EXCLUDE PATTERN "integrators" EXCLUDE
    PATTERN "inspection" EXCLUDE)
set(package lib/cmake/raynest)
install(TARGETS raynest_kernel EXPORT raynestTargets COMPONENT development)
install(EXPORT raynestTargets NAMESPACE raynest:: DESTINATION ${package} COMPONENT development)
configure_package_config_file(.ci/raynestConfig.cmake.in ${CMAKE_BINARY_DIR}/raynestConfig.cmake
    INSTALL_DESTINATION ${package})
write_basic_package_version_file(${CMAKE_BINARY_DIR}/raynestConfigVersion.cmake
    COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_BINARY_DIR}/raynestConfig.cmake ${CMAKE_BINARY_DIR}/raynestConfigVersion.cmake
    DESTINATION ${package} COMPONENT development)
