# Defines what `cmake --install` installs, in two components:
#   runtime      bin/raynestd, bin/raynest, lib/raynest/ (the kernel packs and, in shading/, the
#                integrators for each target, in images/ the modules for pictures, Draco and TIFF) and
#                lib/raynest-cuda/; all found relative to bin/
#   development  the engine as a library, its headers and the pack sources in their own folders under
#                include/raynest/, so that find_package(raynest) gives raynest_kernel_pack(), and
#                find_package(raynest COMPONENTS engine) raynest::engine
include(CMakePackageConfigHelpers)

install(TARGETS ${RAYNEST_PACKS} LIBRARY DESTINATION lib/raynest COMPONENT runtime)
get_property(shading GLOBAL PROPERTY RAYNEST_SHADING_MODULES)
install(TARGETS ${shading} LIBRARY DESTINATION lib/raynest/shading COMPONENT runtime)
foreach(module raynest_images raynest_draco raynest_geotiff)
    if(TARGET ${module})
        install(TARGETS ${module} LIBRARY DESTINATION lib/raynest/images COMPONENT runtime)
    endif()
endforeach()
if(TARGET pack_cuda)
    # A package without it is whole: the daemon starts the worker where the pack is.
    install(TARGETS pack_cuda LIBRARY DESTINATION lib/raynest-cuda COMPONENT runtime OPTIONAL)
endif()
install(TARGETS raynestd raynest RUNTIME DESTINATION bin COMPONENT runtime)

install(DIRECTORY engine DESTINATION include/raynest COMPONENT development
    FILES_MATCHING
    PATTERN "*.h" PATTERN "*.def"
    PATTERN "packs/pack.*" PATTERN "packs/variant.cpp"
    PATTERN "integrators" EXCLUDE PATTERN "inspection" EXCLUDE PATTERN "cuda" EXCLUDE)
install(DIRECTORY ${CMAKE_BINARY_DIR}/engine/shading/lists
    DESTINATION include/raynest/engine/shading COMPONENT development)
set(package lib/cmake/raynest)
set_target_properties(raynest_engine PROPERTIES EXPORT_NAME engine)
install(TARGETS raynest_engine raynest_options EXPORT raynestEngineTargets
    ARCHIVE DESTINATION lib COMPONENT development)
install(EXPORT raynestEngineTargets NAMESPACE raynest:: DESTINATION ${package} COMPONENT development)
install(TARGETS raynest_kernel EXPORT raynestTargets COMPONENT development)
install(EXPORT raynestTargets NAMESPACE raynest:: DESTINATION ${package} COMPONENT development)
set(RAYNEST_ENGINE_PACKAGES tl-expected TBB nlohmann_json fmt TinyGLTF)
if(TARGET meshoptimizer::meshoptimizer)
    list(APPEND RAYNEST_ENGINE_PACKAGES meshoptimizer)
endif()
configure_package_config_file(.ci/raynestConfig.cmake.in ${CMAKE_BINARY_DIR}/raynestConfig.cmake
    INSTALL_DESTINATION ${package})
write_basic_package_version_file(${CMAKE_BINARY_DIR}/raynestConfigVersion.cmake
    COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_BINARY_DIR}/raynestConfig.cmake ${CMAKE_BINARY_DIR}/raynestConfigVersion.cmake
    DESTINATION ${package} COMPONENT development)
