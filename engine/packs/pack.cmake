# raynest_kernel_pack(<target> TARGET v2|v3|v4 [INTERSECTORS <file>] [PRIMITIVES <file>] [HEADERS <dir>...])
#
# Builds one loadable module with every intersector of a list compiled for one CPU target, exporting the one symbol
# raynest_pack. INTERSECTORS has rows RAYNEST_INTERSECTOR(name, Type, overrides...), PRIMITIVES has rows
# RAYNEST_PRIMITIVE(name, Type); headers are <name>.h, looked up in HEADERS (default: the folder of the list). Without
# PRIMITIVES the pack knows the built-in types; with it, the built-in types and those of the file.
#
# This file is installed: an intersector of your own becomes a pack with a four-line CMakeLists.txt
# (engine/INTERSECTORS.md).

# Internal cache entries: the functions below are called from folders that do not see this file's scope.
set(RAYNEST_PACK_SOURCE_DIR ${CMAKE_CURRENT_LIST_DIR} CACHE INTERNAL "")

# _raynest_read_list(<file> <macro> <prefix> <form>): reads the rows RAYNEST_<macro>(...) of a list, a .def file. Their
# form is "name, ...": as many words, and more only where it ends with dots. Sets <prefix>_NAMES to the names, and
# <prefix>_<name> to the words behind each.
function(_raynest_read_list file macro prefix form)
    set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${file})
    file(READ ${file} text)
    string(REGEX REPLACE "\n[ \t]*(//|#)[^\n]*" "\n" text "\n${text}")
    string(REGEX REPLACE "[][;]" " " text "${text}")  # CMake's own lists know these signs
    set(row "RAYNEST_${macro}\\(([^()\"]|\"[^\"]*\")*\\)")
    string(REGEX MATCHALL "${row}" rows "${text}")
    string(REGEX REPLACE "${row}" "" rest "${text}")
    string(STRIP "${rest}" rest)
    string(REGEX MATCHALL "," least "${form}")
    list(LENGTH least least)
    set(names "")
    foreach(row IN LISTS rows)
        string(REGEX MATCHALL "[(,]([^(),\"]|\"[^\"]*\")*" words "${row}")
        list(TRANSFORM words REPLACE "^[(,][ \t\n]*|[ \t\n]+$|\"" "")
        list(POP_FRONT words name)
        list(LENGTH words count)
        if(NOT name MATCHES "^[A-Za-z0-9_]+$" OR "" IN_LIST words OR count LESS least
                OR (count GREATER least AND NOT form MATCHES "\\.\\.\\.$"))
            set(rest "${row}")
        endif()
        list(APPEND names ${name})
        set(${prefix}_${name} ${words} PARENT_SCOPE)
    endforeach()
    if(NOT rest STREQUAL "")
        message(FATAL_ERROR "${file}: '${rest}': a row is RAYNEST_${macro}(${form})")
    endif()
    set(${prefix}_NAMES ${names} PARENT_SCOPE)
endfunction()

# What a CPU target is made of, by its name.
function(_raynest_cpu_target name highway flags)
    list(TRANSFORM ARGN REPLACE "(.+)" "__builtin_cpu_supports(\"\\1\")" OUTPUT_VARIABLE tests)
    list(JOIN tests "&&" test)
    separate_arguments(flags UNIX_COMMAND "${flags}")
    set(_raynest_name_${name} ${name} CACHE INTERNAL "")
    set(_raynest_flags_${name} ${flags} CACHE INTERNAL "")
    set(_raynest_definitions_${name} RAYNEST_HIGHWAY_TARGET=${highway} CACHE INTERNAL "")
    set(_raynest_variant_${name} ${RAYNEST_PACK_SOURCE_DIR}/variant.cpp CACHE INTERNAL "")
    set(_raynest_cpu_${name} ${test} CACHE INTERNAL "")
endfunction()
_raynest_read_list(${RAYNEST_PACK_SOURCE_DIR}/targets.def CPU_TARGET _raynest_target "name, Highway, flags, features...")
set(RAYNEST_CPU_TARGETS ${_raynest_target_NAMES} CACHE INTERNAL "")
foreach(name IN LISTS RAYNEST_CPU_TARGETS)
    _raynest_cpu_target(${name} ${_raynest_target_${name}})
endforeach()

# Arithmetic that means what it says: explicit fma only, NaN and infinity as IEEE says.
set(RAYNEST_KERNEL_OPTIMISATION -O3 CACHE STRING "Of kernels; answers are the same bits at any level")
# Without SLP vectorisation, which packs scalars into vectors only to store them: what is loaded right
# after waits for the shuffles (measured below instances: 2 to 3 %; elsewhere nothing).
set(RAYNEST_KERNEL_OPTIONS ${RAYNEST_KERNEL_OPTIMISATION} -ffp-contract=off -fno-math-errno -fno-trapping-math
    -fno-tree-slp-vectorize -fvisibility=hidden -fvisibility-inlines-hidden)
set(RAYNEST_KERNEL_DEFINITIONS HWY_DISABLE_PCLMUL_AES HWY_COMPILE_ONLY_STATIC)

function(raynest_kernel_pack pack)
    cmake_parse_arguments(arg "" "TARGET;INTERSECTORS;PRIMITIVES" "HEADERS" ${ARGN})
    if(arg_UNPARSED_ARGUMENTS)
        message(FATAL_ERROR "raynest_kernel_pack(${pack}): has TARGET, INTERSECTORS, PRIMITIVES and HEADERS, not "
            "'${arg_UNPARSED_ARGUMENTS}'")
    endif()
    if(NOT DEFINED _raynest_name_${arg_TARGET})
        list(JOIN RAYNEST_CPU_TARGETS ", " known)
        message(FATAL_ERROR "raynest_kernel_pack(${pack}): TARGET is one of ${known}, not '${arg_TARGET}'")
    endif()
    set(builtin ${RAYNEST_PACK_SOURCE_DIR}/../..)
    if(NOT arg_INTERSECTORS)
        set(arg_INTERSECTORS ${builtin}/engine/intersectors/intersectors.def)
    endif()
    get_filename_component(arg_INTERSECTORS ${arg_INTERSECTORS} ABSOLUTE)
    get_filename_component(list_dir ${arg_INTERSECTORS} DIRECTORY)
    if(NOT arg_HEADERS)
        set(arg_HEADERS ${list_dir})
    endif()

    # One generated header with the primitive types, one with the variants' functions.
    set(generated ${CMAKE_CURRENT_BINARY_DIR}/${pack}.generated)
    set(includes "")
    set(calls "")
    foreach(file IN ITEMS ${builtin}/engine/geometry/primitives.def ${arg_PRIMITIVES})
        get_filename_component(file ${file} ABSOLUTE)
        get_filename_component(dir ${file} DIRECTORY)
        _raynest_read_list(${file} PRIMITIVE primitive "name, Type")
        foreach(name IN LISTS primitive_NAMES)
            string(APPEND includes "#include \"${dir}/${name}.h\"\n")
            string(APPEND calls " X(${name}, ${primitive_${name}})")
        endforeach()
    endforeach()
    file(CONFIGURE OUTPUT ${generated}/record_types.h CONTENT
        "#pragma once\n${includes}#define RAYNEST_FOR_EACH_RECORD_TYPE(X)${calls}\n" @ONLY)

    set(objects "")
    set(variants "")
    _raynest_read_list(${arg_INTERSECTORS} INTERSECTOR isect "name, Type, overrides...")
    foreach(name IN LISTS isect_NAMES)
        set(words ${isect_${name}})
        list(POP_FRONT words type)
        set(known boxes primitives instances)
        foreach(word IN LISTS words)
            if(NOT word IN_LIST known AND NOT word STREQUAL "none")
                message(FATAL_ERROR
                    "${arg_INTERSECTORS}: ${name}: '${word}' is none of boxes, primitives, instances, none")
            endif()
        endforeach()
        # One definition each: nvcc takes a comma for the end of a definition.
        set(overrides "")
        foreach(word IN LISTS known)
            string(TOUPPER ${word} upper)
            set(value false)
            if(word IN_LIST words)
                set(value true)
            endif()
            list(APPEND overrides RAYNEST_OVERRIDES_${upper}=${value})
        endforeach()

        find_file(header ${name}.h PATHS ${arg_HEADERS} NO_DEFAULT_PATH NO_CACHE REQUIRED)
        set(object ${pack}_${name})
        add_library(${object} OBJECT ${_raynest_variant_${arg_TARGET}})
        target_link_libraries(${object} PRIVATE raynest::kernel)
        set_target_properties(${object} PROPERTIES POSITION_INDEPENDENT_CODE ON CXX_EXTENSIONS OFF)
        target_compile_options(${object} PRIVATE ${_raynest_flags_${arg_TARGET}})
        target_compile_definitions(${object} PRIVATE
            RAYNEST_INTERSECTOR_HEADER="${header}"
            RAYNEST_INTERSECTOR_TYPE=${type}
            RAYNEST_INTERSECTOR_NAME="${name}"
            RAYNEST_INTERSECTOR_FUNCTION=raynest_variant_${name}
            ${overrides}
            ${_raynest_definitions_${arg_TARGET}}
            RAYNEST_RECORD_TYPES="${generated}/record_types.h")
        unset(header)
        list(APPEND objects $<TARGET_OBJECTS:${object}>)
        string(APPEND variants "RAYNEST_VARIANT(raynest_variant_${name})\n")
    endforeach()
    file(CONFIGURE OUTPUT ${generated}/variants.inc CONTENT "${variants}" @ONLY)

    add_library(${pack} MODULE ${RAYNEST_PACK_SOURCE_DIR}/pack.cpp ${objects})
    target_link_libraries(${pack} PRIVATE raynest::kernel)
    # The table itself must run on any CPU; sphere.h and the like need no more than SSE2 here.
    target_compile_definitions(${pack} PRIVATE
        ${_raynest_definitions_${arg_TARGET}}
        RAYNEST_TARGET_NAME="${_raynest_name_${arg_TARGET}}"
        RAYNEST_VARIANT_LIST="${generated}/variants.inc"
        RAYNEST_RECORD_TYPES="${generated}/record_types.h")
    if(_raynest_cpu_${arg_TARGET})
        target_compile_definitions(${pack} PRIVATE
            "RAYNEST_CPU_TEST=(${_raynest_cpu_${arg_TARGET}})")
    endif()
    set(exports ${RAYNEST_PACK_SOURCE_DIR}/pack.map)
    target_link_options(${pack} PRIVATE -Wl,--no-undefined -Wl,--version-script=${exports})
    set_target_properties(${pack} PROPERTIES PREFIX "" OUTPUT_NAME ${pack} LINK_DEPENDS ${exports}
        CXX_EXTENSIONS OFF)
endfunction()
