# cpack reads this before it packs.

# The same build gives the same bytes: every file of a package has the time of the changelog's last entry.
if(NOT DEFINED ENV{SOURCE_DATE_EPOCH})
    execute_process(COMMAND dpkg-parsechangelog -STimestamp -l ${CPACK_RAYNEST_CHANGELOG}
        OUTPUT_VARIABLE time OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
    set(ENV{SOURCE_DATE_EPOCH} ${time})
endif()

# Pictures' library brings 699 MB with it, and is loaded with the first picture alone: a recommendation.
# CPack itself would make it a dependency, because a file of the package links it.
list(FIND CPACK_COMPONENTS_ALL runtime has_runtime)
if(NOT has_runtime EQUAL -1)
    set(binaries ${CPACK_RAYNEST_BUILD}/bin/raynestd ${CPACK_RAYNEST_BUILD}/bin/raynest)
    file(GLOB_RECURSE modules ${CPACK_RAYNEST_BUILD}/lib/raynest/*.so)
    set(images ${modules})
    list(FILTER images INCLUDE REGEX /raynest-images\\.so$)
    list(FILTER modules EXCLUDE REGEX /raynest-images\\.so$)
    # dpkg-shlibdeps reads the name of the source package from debian/control.
    file(WRITE ${CPACK_RAYNEST_BUILD}/dependencies/debian/control "Source: raynest\n")
    execute_process(COMMAND dpkg-shlibdeps -O ${binaries} ${modules} -dRecommends ${images}
        WORKING_DIRECTORY ${CPACK_RAYNEST_BUILD}/dependencies
        OUTPUT_VARIABLE found ERROR_VARIABLE why RESULT_VARIABLE failed)
    if(failed)
        message(FATAL_ERROR "dpkg-shlibdeps: ${why}")
    endif()
    string(REGEX MATCH "shlibs:Depends=([^\n]*)" depends "${found}")
    set(CPACK_DEBIAN_RUNTIME_PACKAGE_DEPENDS "${CMAKE_MATCH_1}, adduser")
    if(found MATCHES "shlibs:Recommends=([^\n]*)")
        set(CPACK_DEBIAN_RUNTIME_PACKAGE_RECOMMENDS "${CMAKE_MATCH_1}")
    endif()
endif()
