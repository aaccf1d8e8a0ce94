# Debian packages, `cpack -G DEB` in the build folder: raynest, python3-raynest and libraynest-dev.
set(package ${PROJECT_SOURCE_DIR}/server/package)
set(manual ${CMAKE_BINARY_DIR}/manual)
find_package(Python3 COMPONENTS Interpreter)
if(Python3_FOUND)
    add_custom_command(OUTPUT ${manual}/raynest.1 ${manual}/raynestd.8
        COMMAND ${CMAKE_COMMAND} -E env LC_ALL=C.UTF-8 ${Python3_EXECUTABLE}
            ${PROJECT_SOURCE_DIR}/.ci/manual.py ${manual}
            $<TARGET_FILE:raynest> $<TARGET_FILE:raynestd>
        DEPENDS ${PROJECT_SOURCE_DIR}/.ci/manual.py raynest raynestd
        COMMENT "man pages and completions from --help" VERBATIM)
    add_custom_target(manual DEPENDS ${manual}/raynest.1)
    install(FILES ${manual}/raynest.1.gz DESTINATION share/man/man1 COMPONENT runtime OPTIONAL)
    install(FILES ${manual}/raynestd.8.gz DESTINATION share/man/man8 COMPONENT runtime OPTIONAL)
    foreach(program raynest raynestd)
        install(FILES ${manual}/${program}.bash DESTINATION share/bash-completion/completions
            RENAME ${program} COMPONENT runtime OPTIONAL)
        install(FILES ${manual}/_${program} DESTINATION share/zsh/vendor-completions
            COMPONENT runtime OPTIONAL)
    endforeach()
endif()
install(FILES ${package}/raynestd.service ${package}/raynestd.socket
    DESTINATION lib/systemd/system COMPONENT runtime)
install(FILES ${package}/alerts.yml DESTINATION share/doc/raynest/examples COMPONENT runtime)
install(FILES ${package}/raynestd.toml DESTINATION /etc/raynest COMPONENT runtime)
find_program(RAYNEST_GZIP gzip)
mark_as_advanced(RAYNEST_GZIP)
set(changelog ${CMAKE_BINARY_DIR}/changelog.gz)
if(RAYNEST_GZIP)
    execute_process(COMMAND ${RAYNEST_GZIP} -9nc ${package}/changelog OUTPUT_FILE ${changelog})
endif()
foreach(component runtime python development)
    set(name raynest)
    if(component STREQUAL python)
        set(name python3-raynest)
    elseif(component STREQUAL development)
        set(name libraynest-dev)
    endif()
    install(FILES ${package}/copyright DESTINATION share/doc/${name} COMPONENT ${component})
    install(FILES ${changelog} DESTINATION share/doc/${name} COMPONENT ${component} OPTIONAL)
endforeach()
install(FILES server/OPERATING.md server/SECURITY.md server/SHARES.md DESTINATION share/doc/raynest COMPONENT runtime)
install(DIRECTORY client/python/raynest DESTINATION lib/python3/dist-packages COMPONENT python
    FILES_MATCHING PATTERN "*.py" PATTERN "py.typed" PATTERN "__pycache__" EXCLUDE)
# A link in the source tree.
install(FILES protocol/messages.fbs DESTINATION lib/python3/dist-packages/raynest COMPONENT python)

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME raynest)
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGE_CONTACT "The RayNest authors <raynest@example.org>")
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_COMPONENTS_ALL runtime python development)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_RUNTIME_PACKAGE_NAME raynest)
# Its dependencies, and the time of all files, are found when cpack runs.
set(CPACK_PROJECT_CONFIG_FILE ${PROJECT_SOURCE_DIR}/.ci/package_run.cmake)
set(CPACK_RAYNEST_BUILD ${CMAKE_BINARY_DIR})
set(CPACK_RAYNEST_CHANGELOG ${package}/changelog)
set(CPACK_DEBIAN_RUNTIME_DESCRIPTION
    "daemon and command line that trace rays through scenes
raynestd holds scenes and traces millions of rays for its clients; raynest
is the command line. The intersector that decides what counts as a hit is
named in each request.")
set(CPACK_DEBIAN_RUNTIME_PACKAGE_CONTROL_EXTRA
    ${package}/conffiles ${package}/postinst ${package}/prerm ${package}/postrm)
set(CPACK_DEBIAN_RUNTIME_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_DEBIAN_PYTHON_PACKAGE_NAME python3-raynest)
set(CPACK_DEBIAN_PYTHON_PACKAGE_SECTION python)
set(CPACK_DEBIAN_PYTHON_PACKAGE_ARCHITECTURE all)
set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS "python3 (>= 3.9), python3-numpy")
set(CPACK_DEBIAN_PYTHON_PACKAGE_CONTROL_EXTRA ${package}/python/prerm)
set(CPACK_DEBIAN_PYTHON_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_DEBIAN_PYTHON_DESCRIPTION
    "Python client of raynestd, which traces rays through scenes
Sends numpy arrays of rays to a raynestd and gets columns of hits back.")
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_NAME libraynest-dev)
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_DEPENDS "libglm-dev, libhwy-dev, libexpected-dev")
# For programs that embed the engine; a kernel pack needs none of them.
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_RECOMMENDS
    "libfmt-dev, libmeshoptimizer-dev, libseccomp-dev, libssl-dev, libtbb-dev, libtinygltf-dev, nlohmann-json3-dev, raynest, zlib1g-dev")
set(CPACK_DEBIAN_DEVELOPMENT_DESCRIPTION
    "kernel packs for raynestd, and its engine as a library
The headers and the CMake configuration with which an intersector is
compiled into a kernel pack that raynestd loads, and the engine for programs
that trace rays without a daemon.")
include(CPack)
