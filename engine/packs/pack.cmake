# raynest_kernel_pack(<target> TARGET v2|v3|v4 [LIST <file>] [PRIMITIVES <file>] [HEADERS <dir>...])
#
# Builds one loadable module with every intersector of LIST compiled for one CPU target, exporting the
# one symbol raynest_pack. Lines of LIST are `name Type overrides...`, lines of PRIMITIVES `name Type`;
# headers are <name>.h, looked up in HEADERS (default: the folder of the list). Without PRIMITIVES the
# pack knows the built-in types; with it, the built-in types and those of the file.
#
# This file is installed: an intersector of your own becomes a pack with a four-line CMakeLists.txt
# (engine/INTERSECTORS.md).

# Internal cache entries: the function below is called from folders that do not see this file's scope.
set(RAYNEST_PACK_SOURCE_DIR ${CMAKE_CURRENT_LIST_DIR} CACHE INTERNAL "")

# _raynest_cpu_target(<name> <march> <Highway's name> <features of the CPU>... [FLAGS ...]): THE LIST of CPU
# targets. A pack of one runs where the CPU has the features; the last one that does is preferred.
set(RAYNEST_CPU_TARGETS "" CACHE INTERNAL "")
function(_raynest_cpu_target name march highway)
    cmake_parse_arguments(arg "" "" "FLAGS" ${ARGN})
    list(TRANSFORM arg_UNPARSED_ARGUMENTS REPLACE "(.+)" "__builtin_cpu_supports(\"\\1\")" OUTPUT_VARIABLE tests)
    list(JOIN tests "&&" test)
    set(RAYNEST_CPU_TARGETS ${RAYNEST_CPU_TARGETS} ${name} CACHE INTERNAL "")
    set(_raynest_name_${name} ${name} CACHE INTERNAL "")
    set(_raynest_flags_${name} -march=${march} ${arg_FLAGS} CACHE INTERNAL "")
    set(_raynest_definitions_${name} RAYNEST_HIGHWAY_TARGET=${highway} CACHE INTERNAL "")
    set(_raynest_variant_${name} ${RAYNEST_PACK_SOURCE_DIR}/variant.cpp CACHE INTERNAL "")
    set(_raynest_cpu_${name} ${test} CACHE INTERNAL "")
endfunction()
_raynest_cpu_target(v2 x86-64-v2 HWY_SSE4 sse4.2 popcnt)
_raynest_cpu_target(v3 x86-64-v3 HWY_AVX2 avx2 fma bmi2)
_raynest_cpu_target(v4 x86-64-v4 HWY_AVX3 avx512f avx512vl avx512dq avx512bw avx512cd avx2 fma bmi2
    FLAGS -mprefer-vector-width=256)

# Arithmetic that means what it says: explicit fma only, NaN and infinity as IEEE says.
set(RAYNEST_KERNEL_OPTIMISATION -O3 CACHE STRING "Of kernels; answers are the same bits at any level")
# Without SLP vectorisation, which packs scalars into vectors only to store them: what is loaded right
# after waits for the shuffles (measured below instances: 2 to 3 %; elsewhere nothing).
set(RAYNEST_KERNEL_OPTIONS ${RAYNEST_KERNEL_OPTIMISATION} -ffp-contract=off -fno-math-errno -fno-trapping-math
    -fno-tree-slp-vectorize -fvisibility=hidden -fvisibility-inlines-hidden)
set(RAYNEST_KERNEL_DEFINITIONS HWY_DISABLE_PCLMUL_AES HWY_COMPILE_ONLY_STATIC)

# _raynest_read_list(<file> <prefix> [<words>]): reads a list file, whose lines are `name Type`, or with <words>, which
# says what they are, `name Type words...`. Sets <prefix>_NAMES, <prefix>_TYPE_<name>, <prefix>_WORDS_<name>, and
# <prefix>_ROWS: a macro's arguments for each line.
function(_raynest_read_list file prefix)
    set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${file})
    file(STRINGS ${file} lines REGEX "^[^#]")
    set(names "")
    set(rows "")
    foreach(line IN LISTS lines)
        string(REGEX MATCH "^[ \t]*([A-Za-z0-9_]+)[ \t]+([^ \t]+)([ \t]+.+)?$" matched "${line}")
        string(STRIP "${CMAKE_MATCH_3}" words)
        if(NOT matched OR (words STREQUAL "" AND ARGC GREATER 2) OR (NOT words STREQUAL "" AND ARGC EQUAL 2))
            set(form "name Type")
            set(remedy "")
            if(ARGC GREATER 2)
                string(APPEND form " words...")
                set(remedy "; words are ${ARGV2}")
            endif()
            message(FATAL_ERROR "${file}: '${line}': a line is `${form}`${remedy}")
        endif()
        set(name ${CMAKE_MATCH_1})
        set(type ${CMAKE_MATCH_2})
        separate_arguments(words UNIX_COMMAND "${words}")
        list(APPEND names ${name})
        string(APPEND rows " X(${name}, ${type})")
        set(${prefix}_TYPE_${name} ${type} PARENT_SCOPE)
        set(${prefix}_WORDS_${name} ${words} PARENT_SCOPE)
    endforeach()
    set(${prefix}_NAMES ${names} PARENT_SCOPE)
    set(${prefix}_ROWS "${rows}" PARENT_SCOPE)
endfunction()

function(raynest_kernel_pack pack)
    cmake_parse_arguments(arg "" "TARGET;LIST;PRIMITIVES" "HEADERS" ${ARGN})
    if(NOT DEFINED _raynest_name_${arg_TARGET})
        list(JOIN RAYNEST_CPU_TARGETS ", " known)
        message(FATAL_ERROR "raynest_kernel_pack(${pack}): TARGET is one of ${known}, not '${arg_TARGET}'")
    endif()
    set(builtin ${RAYNEST_PACK_SOURCE_DIR}/../..)
    if(NOT arg_LIST)
        set(arg_LIST ${builtin}/engine/intersectors/LIST)
    endif()
    get_filename_component(list_dir ${arg_LIST} DIRECTORY)
    if(NOT arg_HEADERS)
        set(arg_HEADERS ${list_dir})
    endif()

    # One generated header with the primitive types, one with the variants' functions.
    set(generated ${CMAKE_CURRENT_BINARY_DIR}/${pack}.generated)
    set(includes "")
    set(calls "")
    set(files ${builtin}/engine/geometry/PRIMITIVES)
    if(arg_PRIMITIVES)
        list(APPEND files ${arg_PRIMITIVES})
    endif()
    foreach(file IN LISTS files)
        _raynest_read_list(${file} primitive)
        get_filename_component(dir ${file} DIRECTORY)
        foreach(name IN LISTS primitive_NAMES)
            string(APPEND includes "#include \"${dir}/${name}.h\"\n")
        endforeach()
        string(APPEND calls "${primitive_ROWS}")
    endforeach()
    file(CONFIGURE OUTPUT ${generated}/record_types.h CONTENT
        "#pragma once\n${includes}#define RAYNEST_FOR_EACH_RECORD_TYPE(X)${calls}\n" @ONLY)

    set(objects "")
    set(variants "")
    _raynest_read_list(${arg_LIST} isect "its overrides: boxes, primitives, instances or none")
    foreach(name IN LISTS isect_NAMES)
        set(type ${isect_TYPE_${name}})
        set(words ${isect_WORDS_${name}})
        set(known boxes primitives instances)
        foreach(word IN LISTS words)
            if(NOT word IN_LIST known AND NOT word STREQUAL "none")
                message(FATAL_ERROR "${arg_LIST}: ${name}: '${word}' is none of boxes, primitives, instances, none")
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
